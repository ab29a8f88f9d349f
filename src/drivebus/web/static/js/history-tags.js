// Tags that the historian has, and their names. A request of the history with an unknown tag is refused as a whole.
import { api } from "./api.js";
import { addSignalNames } from "./signal-names.js";
import { nowMs } from "./store.js";

/** New tags appear when a drive answers for the first time: the list is loaded again at most this often. */
const MIN_AGE_MS = 60_000;

let known = new Set();
let loadedAt = -Infinity;
let loading = null;

/** Load the tags and add the names of their signals; without an answer the known ones stay. */
export function loadHistoryTags() {
  loading ??= api.get("/history/tags").then(({ tags }) => {
    known = new Set(tags.map(({ tag }) => tag));
    loadedAt = nowMs();
    addSignalNames(tags);
  }, () => null).finally(() => { loading = null; });
  return loading;
}

/** Drive and signal of a tag, "fan-1.output_frequency". */
export function splitTag(tag) {
  const dot = tag.indexOf(".");
  return [tag.slice(0, dot), tag.slice(dot + 1)];
}

/** Return those of the tags that the historian has. */
export async function withHistory(tags) {
  const isOld = nowMs() - loadedAt > MIN_AGE_MS;
  if (isOld && !tags.every((tag) => known.has(tag))) await loadHistoryTags();
  return tags.filter((tag) => known.has(tag));
}
