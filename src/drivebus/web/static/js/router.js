// Addresses behind the #: #/drive/fan-1?tab=faults → {page: "drive", id: "fan-1", query: {tab: "faults"}}.
import { signal } from "./lib.js";

function parse(hash) {
  const [path, search = ""] = hash.replace(/^#\/?/, "").split("?");
  const [page, id] = path.split("/").map(decodeURIComponent);
  return { page: page || "fleet", id: id || null, query: Object.fromEntries(new URLSearchParams(search)) };
}

const read = () => {
  try {
    return parse(location.hash);
  } catch {
    return parse("");
  }
};

export const route = signal(read());
addEventListener("hashchange", () => { route.value = read(); });

/** An address to link to: `href("drive", "fan-1", {tab: "faults"})`. */
export function href(page, id = null, query = {}) {
  const search = new URLSearchParams(Object.entries(query).filter(([, value]) => value !== null && value !== ""));
  const tail = search.size ? `?${search}` : "";
  return `#/${page}${id === null ? "" : `/${encodeURIComponent(id)}`}${tail}`;
}

export function go(page, id = null, query = {}) {
  location.hash = href(page, id, query);
}

/** Change the query of the address without a new entry in the browser's history. */
export function replaceQuery(query) {
  const { page, id } = route.peek();
  history.replaceState(null, "", href(page, id, query));
  route.value = read();
}
