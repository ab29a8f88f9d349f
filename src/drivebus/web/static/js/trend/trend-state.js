// State of one trend: its window, whether it follows the present, the moment under the pointer, and its two cursors.
import { signal } from "../lib.js";
import { serviceNow } from "../store.js";
import { clamped, validWindow, zoomed } from "./window.js";

const MAX_PREVIOUS = 50;

export class TrendState {
  /** Follow the last `span_s` seconds, or show a given window. The lines of the tags `hidden` are hidden at first. */
  constructor(span_s, window = null, hidden = []) {
    const now = serviceNow();
    this.window = signal(window ?? { from: now - span_s * 1000, to: now });
    this.isLive = signal(window === null);
    /** The moment under the pointer, null outside. */
    this.pointed = signal(null);
    /** Place of the pointer in the chart, in pixels: `{x, width}`. */
    this.place = signal({ x: 0, width: 1 });
    /** `{a, b}` in ms, or null while they are off. */
    this.cursors = signal(null);
    this.hidden = signal(new Set(hidden));
    /** Tags that the user has shown again, newest first: their units have the axes. */
    this.recent = [];
    /** Windows before each step, for `back`. */
    this.previous = [];
  }

  /** Length of the window in ms. */
  get span() {
    const { from, to } = this.window.peek();
    return to - from;
  }

  /** Show another window. A window that reaches the present follows it, because the future has no samples. */
  show(window, { isStep = false } = {}) {
    if (isStep) this._remember();
    const { from, to } = validWindow(window);
    const now = serviceNow();
    this.isLive.value = to >= now;
    this.window.value = to >= now ? { from: now - (to - from), to: now } : { from, to };
  }

  /** Change the length of the window: it still ends now while it follows, else its middle stays. */
  setSpan(seconds) {
    this._remember();
    if (this.isLive.peek()) this.follow(seconds * 1000);
    else this.show(zoomed(this.window.peek(), (seconds * 1000) / this.span));
  }

  zoom(factor) {
    this._remember();
    if (this.isLive.peek()) this.follow(clamped(this.span * factor));
    else this.show(zoomed(this.window.peek(), factor));
  }

  follow(span = this.span) {
    const now = serviceNow();
    this.isLive.value = true;
    this.window.value = { from: now - span, to: now };
  }

  pause() {
    this.isLive.value = false;
  }

  /** Return to the previous window, else double the length. */
  back() {
    const last = this.previous.pop();
    if (!last) this.show(zoomed(this.window.peek(), 2));
    else if (last.isLive) this.follow(last.span);
    else this.show(last.window);
  }

  toggleCursors() {
    const { from, to } = this.window.peek();
    this.cursors.value = this.cursors.peek() ? null : { a: from + (to - from) / 3, b: from + ((to - from) * 2) / 3 };
  }

  toggleLine(tag) {
    const next = new Set(this.hidden.peek());
    this.recent = this.recent.filter((other) => other !== tag);
    if (next.delete(tag)) this.recent.unshift(tag);
    else next.add(tag);
    this.hidden.value = next;
  }

  _remember() {
    this.previous.push({ window: this.window.peek(), isLive: this.isLive.peek(), span: this.span });
    if (this.previous.length > MAX_PREVIOUS) this.previous.shift();
  }
}
