// Where a trend's samples come from: the historian in windows, and what came live since.
import { api } from "../api.js";
import { signal } from "../lib.js";
import { serviceNow, drive as driveTopic, topic } from "../store.js";
import { subscribe, isLive } from "../live.js";
import { BAD, GOOD, UNCERTAIN, extended } from "./columns.js";
import { covers, padded } from "./window.js";

const POINTS = 1000;
const FETCH_DELAY_MS = 70;
const MAX_CACHED_WINDOWS = 12;
const LIVE_MS = 15 * 60_000;
const EVENTS = 300;
/** Kinds of events that a trend marks, and the shape of each. */
export const SHAPES = { command: "command", stop: "stop", fault: "fault", alarm: "alarm" };
const QUALITIES = { good: GOOD, uncertain: UNCERTAIN, bad: BAD };

/** One trend's samples. Signals: `series` {tag: {t, min, mean, max, q}}, `resolution`, `state`, `error`. */
export class Source {
  constructor() {
    this.drives = [];
    this.series = signal({});
    this.resolution = signal(null);
    /** "empty" before the first answer, "asking" while one is awaited, "there". */
    this.state = signal("empty");
    this.error = signal(null);
    this.markers = signal({ items: [], isCut: false });
    this.fetched = null;
    this.tags = [];
    this.kept = new Map();
    this.joined = null;
    this.live = new Map();
    this.asked = null;
    this.timer = null;
    this.leave = subscribe("events");
  }

  /** Other tags: what is drawn of those that stay is kept until the answer comes. */
  choose(tags, drives) {
    this.tags = tags;
    this.drives = drives;
    this.kept.clear();
    this.fetched = null;
    this.joined = null;
  }

  /** Sees to it that a window is there soon; the last one asked for wins, and a wheel's turn asks once. `again` asks
   * for the same one anew: its samples only, since what happens meanwhile is told live. */
  want(window, { again = false } = {}) {
    if (!this.tags.length) return;
    if (!again && this.fetched && covers(this.fetched, window, serviceNow())) return;
    const kept = again ? null : this._kept(window);
    if (kept) { this._show(kept); return; }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this._fetch(window, again), FETCH_DELAY_MS);
  }

  /** The drives' newest values as samples of their own, where they changed. */
  listen() {
    for (const tag of this.tags) {
      const dot = tag.indexOf(".");
      const view = driveTopic(tag.slice(0, dot)).peek();
      this._note(tag, view?.signals?.[tag.slice(dot + 1)]);
    }
    this._hear();
  }

  /** The series to draw: the historian's, and live ones after them. */
  whole() {
    this.joined ??= this._join();
    return this.joined;
  }

  _join() {
    const now = serviceNow();
    return Object.fromEntries(this.tags.map((tag) => {
      const series = this.series.peek()[tag] ?? EMPTY;
      // What is fetched of the past ends long before what is live: nothing joins them.
      const isRecent = this.fetched !== null
        && now - this.fetched.to < 60_000 + (this.fetched.to - this.fetched.from) / 4;
      return [tag, isRecent ? extended(series, this.live.get(tag) ?? []) : series];
    }));
  }

  close() {
    this.leave();
    clearTimeout(this.timer);
    this.asked?.abort();
  }

  _note(tag, found) {
    const samples = this.live.get(tag) ?? [];
    const isKnown = isLive.peek() && found && typeof found.value === "number";
    const sample = isKnown
      ? { t: found.source_time_ms, v: found.value, q: QUALITIES[found.quality] }
      : { t: Math.round(serviceNow()), v: null, q: BAD };
    const last = samples.at(-1);
    // A value that was not read anew keeps its moment within the jitter of the line, unless its quality changed.
    if (last && last.q === sample.q && (sample.q === BAD || sample.t - last.t < 40)) return;
    if (last && sample.t <= last.t) sample.t = last.q === sample.q ? last.t : Math.round(serviceNow());
    samples.push(sample);
    while (samples.length && samples[0].t < sample.t - LIVE_MS) samples.shift();
    this.live.set(tag, samples);
    this.joined = null;
  }

  /** Commands, faults and alarms as they happen. */
  _hear() {
    const { items, isCut } = this.markers.peek();
    const known = new Set(items.map((event) => event.id));
    const news = (topic("events").peek()?.items ?? []).filter((event) => this._marks(event) && !known.has(event.id));
    if (news.length) this.markers.value = { items: [...items, ...news].sort(byTime), isCut };
  }

  _marks(event) {
    return event.kind in SHAPES && this.drives.includes(event.drive);
  }

  _kept(window) {
    const found = [...this.kept.values()].reverse().find((answer) => covers(answer.span, window, serviceNow()));
    return found && found.span.isPast ? found : null;
  }

  async _fetch(window, again) {
    this.asked?.abort();
    const asked = this.asked = new AbortController();
    const span = padded(window, serviceNow());
    this.state.value = "asking";
    try {
      const [answer, markers] = await Promise.all([
        this._trend(span, asked.signal), again ? this.markers.peek() : this._events(span, asked.signal),
      ]);
      if (asked.signal.aborted) return;
      this._keep({ span: { ...span, isPast: span.to < serviceNow() - 60_000 }, answer, markers });
      this.error.value = null;
    } catch (error) {
      if (asked.signal.aborted) return;
      this.error.value = error;
    }
    this.state.value = "there";
  }

  _trend(span, stop) {
    const query = { tags: this.tags, from_ms: span.from, to_ms: span.to, points: POINTS };
    return api.get("/history/trend", query, { signal: stop });
  }

  /** Commands, faults and alarms of the drives shown, oldest first; of a long window only the newest. */
  async _events(span, stop) {
    const query = { from_ms: span.from, to_ms: span.to, limit: EVENTS };
    const asked = this.drives.map((drive) => api.get("/history/events", { ...query, drive }, { signal: stop }));
    const found = await Promise.all(asked);
    const items = found.flatMap((answer) => answer.items.filter((event) => this._marks(event)));
    return {
      items: items.sort(byTime),
      isCut: found.some((answer) => answer.next !== null),
    };
  }

  _keep(found) {
    this.kept.set(`${found.span.from} ${found.span.to}`, found);
    if (this.kept.size > MAX_CACHED_WINDOWS) this.kept.delete(this.kept.keys().next().value);
    this._show(found);
  }

  _show({ span, answer, markers }) {
    this.fetched = span;
    this.resolution.value = answer.resolution;
    this.markers.value = markers;
    this.joined = null;
    this.series.value = answer.series;
  }
}

const byTime = (one, other) => one.time_ms - other.time_ms;

const EMPTY = { t: [], min: [], mean: [], max: [], q: [] };
