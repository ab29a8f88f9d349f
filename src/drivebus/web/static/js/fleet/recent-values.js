// Last minutes of the drives in view: the historian's for the tiles that come into view, up to 50 in one request, then
// live values.
import { signal } from "../lib.js";
import { api } from "../api.js";
import { withHistory } from "../history-tags.js";
import { isLive } from "../live.js";
import { drive, serviceNow } from "../store.js";
import { POINT_COUNT, POINT_MS, addReading, joined, pointNumber } from "./spark-points.js";

/** The historian answers no more tags at once. */
const MAX_TAGS = 50;
/** Tiles that come into view within this time share a request. */
const GATHER_MS = 150;
/** More tiles than on the screen, so that slow scrolling finds them drawn. */
const VIEW_MARGIN = "200px";

const MAIN_SIGNAL = "output_frequency";

/** Signal of a drive that its sparkline shows: the output frequency, else the first one with a unit. */
export function mainSignal(view) {
  const names = Object.keys(view?.signals ?? {});
  return names.includes(MAIN_SIGNAL) ? MAIN_SIGNAL : names.find((name) => view.signals[name].unit) ?? null;
}

/** Recent values of one drive, while its tile exists. */
export class RecentValues {
  constructor(id) {
    this.id = id;
    this.points = [];
    this.isInView = signal(false);
    /** Counts answers of the historian. */
    this.answers = signal(0);
    this.isRequested = false;
    this.lastReading = null;
  }

  get tag() {
    const name = mainSignal(drive(this.id).peek());
    return name && `${this.id}.${name}`;
  }

  /** Add the drive's newest value. */
  add(view) {
    const found = view?.signals?.[mainSignal(view)];
    if (!found || (isLive.peek() && found === this.lastReading)) return;
    this.lastReading = found;
    addReading(this.points, found, isLive.peek(), serviceNow());
  }

  /** Request the missed time once in view. */
  request() {
    if (this.isRequested || !this.isInView.peek() || !isLive.peek() || !this.tag) return;
    this.isRequested = true;
    waiting.add(this);
    timer ??= setTimeout(fetchWaiting, GATHER_MS);
  }

  /** Replace the values from before a lost connection by the historian's. */
  reload() {
    this.points = [];
    this.isRequested = false;
    this.request();
  }

  /** Put the historian's answer before the live values. */
  addHistory(series) {
    this.points = joined(series, this.points);
    this.answers.value += 1;
  }
}

const waiting = new Set();
let timer = null;

/** Fetch the waiting drives, one request after the other; where one fails, the sparklines begin with live values. */
async function fetchWaiting() {
  while (waiting.size > 0) {
    const some = [...waiting].slice(0, MAX_TAGS);
    some.forEach((recent) => waiting.delete(recent));
    const tags = await withHistory(some.map((recent) => recent.tag));
    if (tags.length === 0) continue;
    const to = serviceNow();
    const from = (pointNumber(to) - POINT_COUNT + 1) * POINT_MS;
    const query = { tags, from_ms: from, to_ms: to, points: POINT_COUNT + 1 };
    const answer = await api.get("/history/trend", query).catch(() => null);
    for (const recent of some) if (answer?.series?.[recent.tag]) recent.addHistory(answer.series[recent.tag]);
  }
  timer = null;
}

const byTile = new WeakMap();
const inView = new IntersectionObserver((changes) => {
  for (const { target, isIntersecting } of changes) {
    const recent = byTile.get(target);
    recent.isInView.value = isIntersecting;
    recent.request();
  }
}, { rootMargin: VIEW_MARGIN });

/** Follow whether a tile is in view; returns the function that ends it. */
export function watchTile(tile, recent) {
  byTile.set(tile, recent);
  inView.observe(tile);
  return () => { inView.unobserve(tile); waiting.delete(recent); };
}
