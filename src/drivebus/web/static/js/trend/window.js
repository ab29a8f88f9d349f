// Window of time of a trend. Pure: milliseconds in, milliseconds out.

/** Spans with a button, in seconds: a minute to a year. */
export const SPANS_S = [60, 600, 3600, 28_800, 86_400, 604_800, 2_592_000, 31_536_000];
const SMALLEST_MS = 5_000;
const LARGEST_MS = 4_000 * 86_400_000;

/** A share of the window that is fetched beyond either edge, so that a small pan shows no empty border. */
const MARGIN = 0.25;

/** Length of a window, limited to the allowed range. */
export const clamped = (span) => Math.min(LARGEST_MS, Math.max(SMALLEST_MS, span));

/** The window with an allowed length, around the same middle. */
export function validWindow({ from, to }) {
  const span = clamped(to - from);
  const middle = (from + to) / 2;
  return span === to - from ? { from, to } : { from: middle - span / 2, to: middle + span / 2 };
}

/** The window `factor` times as long, with the moment `at` staying where it is on the screen. */
export function zoomed({ from, to }, factor, at = (from + to) / 2) {
  const span = clamped((to - from) * factor);
  const share = (at - from) / (to - from);
  return { from: at - share * span, to: at + (1 - share) * span };
}

/** The window moved by a share of itself; negative is into the past. */
export function panned({ from, to }, share) {
  const by = (to - from) * share;
  return { from: from + by, to: to + by };
}

/** Window to fetch: wider at both edges, but not beyond now. */
export function padded({ from, to }, now) {
  const more = (to - from) * MARGIN;
  return { from: Math.max(0, Math.floor(from - more)), to: Math.ceil(Math.max(from + 1, Math.min(to + more, now))) };
}

/** Whether a fetched window contains the shown one without being much longer, so that its points are fine enough. */
export function covers(fetched, { from, to }, now) {
  const needed = Math.min(to, now);
  return fetched.from <= from && fetched.to >= needed && fetched.to - fetched.from <= 2 * (to - from);
}

/** Interval between two drawings of a following window: a step of about a pixel, at most 4 times a second. */
export function drawEvery(span) {
  return Math.min(10_000, Math.max(250, span / 1000));
}

/** Interval between two historian requests of a following window. */
export function fetchEvery(span) {
  return Math.min(60_000, Math.max(2_000, span / 200));
}
