// Gestures of a chart: wheel, drag, pinch and keys change its window of time. A drag without Shift selects a stretch,
// which uPlot itself draws; a wheel without Ctrl scrolls the page.

import { panned, zoomed } from "./window.js";

const WHEEL_STEP = 0.0015;
const PAN_STEP = 0.1;

/**
 * @param over the element above the plot
 * @param host the element that has the keyboard's focus
 * @param trend the `TrendState` that they change
 * @returns a function that detaches them
 */
export function attachGestures(over, host, trend) {
  const detached = new AbortController();
  const on = (element, name, listener, options = {}) =>
    element.addEventListener(name, listener, { signal: detached.signal, ...options });
  const share = (x) => (x - over.getBoundingClientRect().left) / over.clientWidth;
  const momentAt = (x) => {
    const { from, to } = trend.window.peek();
    return from + share(x) * (to - from);
  };

  on(over, "wheel", (event) => {
    const sideways = event.shiftKey ? event.deltaY || event.deltaX : event.deltaX;
    if (event.ctrlKey || event.metaKey) {
      trend.show(zoomed(trend.window.peek(), Math.exp(event.deltaY * WHEEL_STEP * 3), momentAt(event.clientX)));
    } else if (Math.abs(sideways) > Math.abs(event.deltaY) || event.shiftKey) {
      trend.show(panned(trend.window.peek(), sideways / over.clientWidth));
    } else return;
    event.preventDefault();
  }, { passive: false });

  attachDrags(over, on, trend, momentAt);
  keepTapped(over, on);
  on(over, "dblclick", () => trend.back());
  on(host, "keydown", (event) => {
    if (event.target !== host || event.ctrlKey || event.metaKey || event.altKey) return;
    const act = KEYS[event.key];
    if (!act) return;
    act(trend);
    event.preventDefault();
  });
  return () => detached.abort();
}

const KEYS = {
  ArrowLeft: (trend) => trend.show(panned(trend.window.peek(), -PAN_STEP)),
  ArrowRight: (trend) => trend.show(panned(trend.window.peek(), PAN_STEP)),
  PageUp: (trend) => trend.show(panned(trend.window.peek(), -1)),
  PageDown: (trend) => trend.show(panned(trend.window.peek(), 1)),
  "+": (trend) => trend.show(zoomed(trend.window.peek(), 0.5)),
  "=": (trend) => trend.show(zoomed(trend.window.peek(), 0.5)),
  "-": (trend) => trend.show(zoomed(trend.window.peek(), 2)),
  Backspace: (trend) => trend.back(),
  End: (trend) => trend.follow(),
};

/** Pan with Shift or the middle mouse button, or one finger; zoom with two fingers. */
function attachDrags(over, on, trend, momentAt) {
  const fingers = new Map();
  let last = null;

  on(over, "mousedown", (event) => {
    if (!event.shiftKey && event.button !== 1) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    last = event.clientX;
  }, { capture: true });
  on(window, "mousemove", (event) => {
    if (last === null) return;
    trend.show(panned(trend.window.peek(), (last - event.clientX) / over.clientWidth));
    last = event.clientX;
  });
  on(window, "mouseup", () => { last = null; });

  on(over, "pointerdown", (event) => {
    if (event.pointerType !== "touch") return;
    fingers.set(event.pointerId, event.clientX);
    over.setPointerCapture(event.pointerId);
  });
  on(over, "pointermove", (event) => {
    if (!fingers.has(event.pointerId)) return;
    const before = [...fingers.values()];
    fingers.set(event.pointerId, event.clientX);
    const after = [...fingers.values()];
    if (after.length === 1) {
      trend.show(panned(trend.window.peek(), (before[0] - after[0]) / over.clientWidth));
    } else if (after.length === 2) {
      const wide = ([one, other]) => Math.max(20, Math.abs(one - other));
      trend.show(zoomed(trend.window.peek(), wide(before) / wide(after), momentAt((after[0] + after[1]) / 2)));
    }
  });
  for (const name of ["pointerup", "pointercancel"]) on(over, name, (event) => fingers.delete(event.pointerId));
}

/** Keep the values at a tap until the next tap elsewhere: a browser with a mouse leaves the chart again at once. */
function keepTapped(over, on) {
  let isTapped = false;
  const follow = ({ pointerType }) => { isTapped = pointerType === "touch"; };
  for (const name of ["pointerdown", "pointermove"]) on(over, name, follow);
  on(over, "mouseleave", (event) => { if (isTapped) event.stopImmediatePropagation(); }, { capture: true });
  on(document, "pointerdown", (event) => {
    if (!isTapped || over.contains(event.target)) return;
    isTapped = false;
    over.dispatchEvent(new MouseEvent("mouseleave"));
  });
}
