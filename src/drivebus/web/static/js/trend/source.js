// Samples of a trend: windows from the historian, and live values since.
import { api } from "../api.js";
import { signal } from "../lib.js";
import { splitTag } from "../history-tags.js";
import { drive, serviceNow, topic } from "../store.js";
import { subscribe, isLive } from "../live.js";
import { BAD, QUALITIES } from "../quality.js";
import { EMPTY_SERIES, extended } from "./columns.js";
import { covers, padded } from "./window.js";

const POINTS = 1000;
const FETCH_DELAY_MS = 70;
const MAX_CACHED_WINDOWS = 12;
const LIVE_MS = 15 * 60_000;
const EVENTS = 300;
/** Kinds of events that a trend marks. */
const MARKED_KINDS = new Set(["command", "stop", "fault", "alarm"]);

/** One trend's samples. Signals: `series` {tag: {t, min, mean, max, q}}, `resolution`, `state`, `error`. */
export class TrendSource {
  constructor() {
    this.drives = [];
    this.series = signal({});
    this.resolution = signal(null);
    /** "empty" before the first answer, "loading" while one is awaited, "loaded". */
    this.state = signal("empty");
    this.error = signal(null);
    this.markers = signal({ items: [], isCut: false });
    this.fetchedWindow = null;
    this.tags = [];
    this.cache = new Map();
    this.joined = null;
    this.live = new Map();
    this.request = null;
    this.timer = null;
    this.unsubscribe = subscribe("events");
  }

  /** Select tags and drives; samples of tags that stay remain until the answer comes. */
  choose(tags, drives) {
    this.tags = tags;
    this.drives = drives;
    this.cache.clear();
    this.fetchedWindow = null;
    this.joined = null;
  }

  /** Load a window after a short delay, so that only the last of many requests is sent. `again` reloads the samples of
   * a window without its events, which arrive live. */
  load(window, { again = false } = {}) {
    if (!this.tags.length) return;
    if (!again && this.fetchedWindow && covers(this.fetchedWindow, window, serviceNow())) return;
    const cached = again ? null : this._cached(window);
    if (cached) { this._show(cached); return; }
    clearTimeout(this.timer);
    this.timer = setTimeout(() => this._fetch(window, again), FETCH_DELAY_MS);
  }

  /** Add the drives' newest values and events as samples and markers, where they changed. */
  takeLive() {
    for (const tag of this.tags) {
      const [id, name] = splitTag(tag);
      this._addLive(tag, drive(id).peek()?.signals?.[name]);
    }
    this._addEvents();
  }

  /** Series to draw: the historian's samples followed by live ones. */
  seriesWithLive() {
    this.joined ??= this._join();
    return this.joined;
  }

  /** Moment up to which the samples tell what is known. */
  end() {
    return serviceNow();
  }

  _join() {
    const now = serviceNow();
    return Object.fromEntries(this.tags.map((tag) => {
      const series = this.series.peek()[tag] ?? EMPTY_SERIES;
      // A window of the past ends long before the live samples: they are not joined.
      const isRecent = this.fetchedWindow !== null
        && now - this.fetchedWindow.to < 60_000 + (this.fetchedWindow.to - this.fetchedWindow.from) / 4;
      return [tag, isRecent ? extended(series, this.live.get(tag) ?? []) : series];
    }));
  }

  close() {
    this.unsubscribe();
    clearTimeout(this.timer);
    this.request?.abort();
  }

  _addLive(tag, found) {
    const samples = this.live.get(tag) ?? [];
    const isKnown = isLive.peek() && found && typeof found.value === "number";
    const sample = isKnown
      ? { t: found.source_time_ms, v: found.value, q: QUALITIES[found.quality] }
      : { t: Math.round(serviceNow()), v: null, q: BAD };
    const last = samples.at(-1);
    // The same reading is not added twice, unless its quality changed.
    if (last && last.q === sample.q && (sample.q === BAD || sample.t - last.t < 40)) return;
    if (last && sample.t <= last.t) sample.t = last.q === sample.q ? last.t : Math.round(serviceNow());
    samples.push(sample);
    while (samples.length && samples[0].t < sample.t - LIVE_MS) samples.shift();
    this.live.set(tag, samples);
    this.joined = null;
  }

  /** Add commands, faults and alarms from the live feed. */
  _addEvents() {
    const { items, isCut } = this.markers.peek();
    const known = new Set(items.map((event) => event.id));
    const news = (topic("events").peek()?.items ?? []).filter((event) => this._marks(event) && !known.has(event.id));
    if (news.length) this.markers.value = { items: [...items, ...news].sort(byTime), isCut };
  }

  _marks(event) {
    return MARKED_KINDS.has(event.kind) && this.drives.includes(event.drive);
  }

  _cached(window) {
    const found = [...this.cache.values()].reverse().find((answer) => covers(answer.span, window, serviceNow()));
    return found && found.span.isPast ? found : null;
  }

  async _fetch(window, again) {
    this.request?.abort();
    const request = this.request = new AbortController();
    const span = padded(window, serviceNow());
    this.state.value = "loading";
    try {
      const [answer, markers] = await Promise.all([
        this._trend(span, request.signal), again ? this.markers.peek() : this._events(span, request.signal),
      ]);
      if (request.signal.aborted) return;
      this._store({ span: { ...span, isPast: span.to < serviceNow() - 60_000 }, answer, markers });
      this.error.value = null;
    } catch (error) {
      if (request.signal.aborted) return;
      this.error.value = error;
    }
    this.state.value = "loaded";
  }

  _trend(span, stop) {
    const query = { tags: this.tags, from_ms: span.from, to_ms: span.to, points: POINTS };
    return api.get("/history/trend", query, { signal: stop });
  }

  /** Commands, faults and alarms of the drives shown, oldest first; of a long window only the newest. */
  async _events(span, stop) {
    const query = { from_ms: span.from, to_ms: span.to, limit: EVENTS };
    const requests = this.drives.map((id) => api.get("/history/events", { ...query, drive: id }, { signal: stop }));
    const found = await Promise.all(requests);
    const items = found.flatMap((answer) => answer.items.filter((event) => this._marks(event)));
    return {
      items: items.sort(byTime),
      isCut: found.some((answer) => answer.next !== null),
    };
  }

  _store(found) {
    this.cache.set(`${found.span.from} ${found.span.to}`, found);
    if (this.cache.size > MAX_CACHED_WINDOWS) this.cache.delete(this.cache.keys().next().value);
    this._show(found);
  }

  _show({ span, answer, markers }) {
    this.fetchedWindow = span;
    this.resolution.value = answer.resolution;
    this.markers.value = markers;
    this.joined = null;
    this.series.value = answer.series;
  }
}

const byTime = (one, other) => one.time_ms - other.time_ms;
