// Addresses behind the #: #/drive/fan-1?tab=faults → {page: "drive", id: "fan-1", query: {tab: "faults"}}.
import { batch, signal } from "./lib.js";

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
/** Number of links and steps of the browser's history followed; a page that changes its own query follows none. */
export const navigations = signal(0);
addEventListener("hashchange", () => { batch(() => { navigations.value += 1; route.value = read(); }); });

/** An address to link to: `href("drive", "fan-1", {tab: "faults"})`. */
export function href(page, id = null, query = {}) {
  const search = new URLSearchParams(Object.entries(query).filter(([, value]) => value !== null && value !== ""));
  const tail = search.size ? `?${search}` : "";
  return `#/${page}${id === null ? "" : `/${encodeURIComponent(id)}`}${tail}`;
}

export function go(page, id = null, query = {}) {
  location.hash = href(page, id, query);
}

/** Change the query of the address without a new entry in the browser's history; not where a link has just led to another
 * address, which the browser reports next. */
export function replaceQuery(query) {
  const shown = route.peek();
  if (JSON.stringify(read()) !== JSON.stringify(shown)) return;
  history.replaceState(history.state, "", href(shown.page, shown.id, query));
  route.value = read();
}

/** Scroll position of each entry of the browser's history, by the mark in its state. */
const positions = new Map();
/** Mark of the entry that is drawn; null while another one is about to be. */
let drawnEntry = null;

addEventListener("popstate", () => { drawnEntry = null; });
addEventListener("scroll", () => { if (drawnEntry !== null) positions.set(drawnEntry, scrollY); }, { passive: true });

/** Show a new entry of the browser's history from its top, and one that the user returns to where it was left. */
export function restoreScroll() {
  if (!history.state?.entry) history.replaceState({ entry: Date.now() }, "");
  drawnEntry = history.state.entry;
  scrollTo(0, positions.get(drawnEntry) ?? 0);
}
