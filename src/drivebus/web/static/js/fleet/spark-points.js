// Points of a sparkline: one for five seconds, and the paths that are drawn from them. Pure.
//
// A point is `{n, sum, count, q, startsBad, endsBad}`: number of its five seconds since 1970, its usable values, and
// whether its first and last samples were bad. Its quality is combined as by the historian: good only if every sample is.

import { BAD, GOOD, QUALITIES, UNCERTAIN } from "../quality.js";

export const POINT_MS = 5000;
export const POINT_COUNT = 60;
/** Size of the drawing, in units of its own. */
export const WIDTH = 118;
export const HEIGHT = 24;
/** A distance beyond this many usual ones is a gap, although nothing marks it. */
const GAP_STEPS = 2;

export const pointNumber = (time_ms) => Math.floor(time_ms / POINT_MS);

/** Add a sample `{t, v, q}`; earlier ones than the last point are ignored, points of the past are dropped. */
export function addSample(points, { t, v, q }) {
  const n = pointNumber(t);
  let last = points.at(-1);
  if (last && n < last.n) return;
  if (!last || n > last.n) {
    last = { n, sum: 0, count: 0, q, startsBad: q === BAD, endsBad: false };
    points.push(last);
  }
  if (q !== last.q) last.q = UNCERTAIN;
  last.endsBad = q === BAD;
  if (q !== BAD) {
    last.sum += v;
    last.count += 1;
  }
  while (points[0].n <= n - POINT_COUNT) points.shift();
}

/** Add a signal of a drive's view; without a connection its value is not known. */
export function addReading(points, found, isLive, now_ms) {
  const isKnown = isLive && typeof found?.value === "number" && found.quality !== "bad";
  addSample(points, isKnown ? { t: found.source_time_ms, v: found.value, q: QUALITIES[found.quality] }
    : { t: now_ms, v: null, q: BAD });
}

/** Points of the historian's answer, then the live ones, which know more of their own time. */
export function joined(series, live) {
  const points = [];
  const first = live[0]?.n ?? Infinity;
  series.t.forEach((t, at) => {
    const v = series.mean[at];
    const q = typeof v === "number" ? series.q[at] : BAD;
    if (pointNumber(t) < first) addSample(points, { t, v, q });
  });
  return [...points, ...live];
}

const mean = (point) => point.sum / point.count;

function usualStep(points) {
  const steps = points.slice(1).map((point, at) => point.n - points[at].n).sort((a, b) => a - b);
  return steps[Math.floor(steps.length / 2)] ?? 1;
}

/** Whether the value was known all the time from one point to the next. */
function isConnected(point, next, usual) {
  if (point.endsBad || next.startsBad || !point.count || !next.count) return false;
  const isDoubtful = point.q !== GOOD || next.q !== GOOD;
  return next.n - point.n <= (isDoubtful ? usual : GAP_STEPS * usual);
}

/** Lowest and highest of the points up to `end`; null where no value is known. */
export function rangeOf(points, end) {
  const known = points.filter((point) => point.count && point.n > end - POINT_COUNT).map(mean);
  return known.length ? { low: Math.min(...known), high: Math.max(...known) } : null;
}

/** Paths of the good and of the uncertain stretches that end at the point number `end`, between `low` and `high`. A
 * point without a neighbour is a dot. */
export function paths(points, end, { low, high }) {
  const shown = points.filter((point) => point.n > end - POINT_COUNT && point.n <= end);
  const usual = usualStep(shown);
  const x = (point) => (((point.n - end) / (POINT_COUNT - 1) + 1) * WIDTH).toFixed(1);
  const y = (point) => (HEIGHT - ((mean(point) - low) / (high - low || 1)) * HEIGHT).toFixed(1);
  const found = { good: "", uncertain: "" };
  let pen = null;
  shown.forEach((point, at) => {
    if (!point.count) return;
    const before = shown[at - 1];
    const isLine = before !== undefined && isConnected(before, point, usual);
    const isDot = !isLine && !(shown[at + 1] && isConnected(point, shown[at + 1], usual));
    if (!isLine && !isDot) return;
    const isGood = point.q === GOOD && (isDot || before.q === GOOD);
    const stroke = isGood ? "good" : "uncertain";
    const isContinued = isLine && pen?.point === before && pen.stroke === stroke;
    found[stroke] += isDot ? `M${x(point)} ${y(point)}h.01` : `${isContinued ? "" : `M${x(before)} ${y(before)}`}L${x(point)} ${y(point)}`;
    pen = { point, stroke };
  });
  return found;
}
