// Conversion of the historian's answer into the columns of a chart. Pure.
//
// A tag becomes four columns: highest, lowest, mean where it is good, mean where it is uncertain. A bad value or a
// gap is null in all of them: nothing is drawn where nothing is known.

import uPlot from "../../../vendor/uplot.js";
import { BAD, GOOD, UNCERTAIN } from "../quality.js";
import { isWhole } from "./lines.js";

export const COLUMNS = 4;

/** How `uPlot.join` treats the nulls of time and columns. A gap of a line lasts from the last known value to the next one,
 * also at the times of other tags: a line through them would show a value where none is known. */
const [RETAIN, EXPAND] = [1, 2];
const GAPS = [RETAIN, RETAIN, RETAIN, EXPAND, EXPAND];

/** @returns {{t: number[], high, low, good, uncertain}} columns of one tag. A word has no mean: where a point stands for
 * several of its values it has a band without a line. */
export function split({ t, min, mean, max, q }, { isWord = false } = {}) {
  const hasLine = isWord && isWhole({ min, max }) ? (at) => min[at] === max[at] : () => true;
  const good = new Array(t.length).fill(null);
  const uncertain = new Array(t.length).fill(null);
  const isThere = (at) => mean[at] !== null && mean[at] !== undefined && q[at] !== BAD;
  for (let at = 0; at < t.length; at += 1) {
    if (!isThere(at) || !hasLine(at)) continue;
    if (q[at] === GOOD) good[at] = mean[at];
    else uncertain[at] = mean[at];
  }
  // The dashed line reaches to its good neighbours.
  for (let at = 0; at < t.length; at += 1) {
    if (good[at] === null) continue;
    const beside = (other) => other >= 0 && other < t.length && uncertain[other] !== null && q[other] === UNCERTAIN;
    if (beside(at - 1) || beside(at + 1)) uncertain[at] = good[at];
  }
  const known = (values) => t.map((_, at) => (isThere(at) ? values[at] ?? mean[at] : null));
  return { t, high: known(max), low: known(min), good, uncertain };
}

/** One table for all tags, over the times of all of them. A tag without samples stays, empty. `words` are the tags of
 * words. */
export function table(tags, series, words = []) {
  const parts = tags.map((tag) => {
    const { t, high, low, good, uncertain } = split(series[tag] ?? EMPTY_SERIES, { isWord: words.includes(tag) });
    return [t, high, low, good, uncertain];
  });
  return parts.length ? uPlot.join(parts, parts.map(() => GAPS)) : [[]];
}

/** Series of a tag without samples. */
export const EMPTY_SERIES = { t: [], min: [], mean: [], max: [], q: [] };

/** A series extended by the live samples after its last one; a null value is a gap. A value that is no longer usable, and
 * was not read after the last stored sample, is a gap behind that. */
export function extended(series, live) {
  const last = series.t.at(-1) ?? -Infinity;
  const newer = live.filter((sample) => sample.t > last);
  if (!newer.length && live.at(-1)?.q === BAD) newer.push({ ...live.at(-1), t: last + 1 });
  if (!newer.length) return series;
  const values = newer.map((sample) => (sample.q === BAD ? null : sample.v));
  return {
    t: [...series.t, ...newer.map((sample) => sample.t)],
    min: [...series.min, ...values],
    mean: [...series.mean, ...values],
    max: [...series.max, ...values],
    q: [...series.q, ...newer.map((sample) => sample.q)],
  };
}

/** Index of the last sample at or before a moment, -1 where there is none. */
export function indexAt(t, moment) {
  let low = 0;
  let high = t.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (t[middle] <= moment) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** Value of a tag at a moment: the sample nearest to it within `reach` ms and its place `at` in the series, or null. */
export function valueAt(series, moment, reach) {
  if (!series) return null;
  const before = indexAt(series.t, moment);
  const [at] = [before, before + 1]
    .filter((index) => index >= 0 && index < series.t.length)
    .sort((one, other) => Math.abs(series.t[one] - moment) - Math.abs(series.t[other] - moment));
  if (at === undefined || Math.abs(series.t[at] - moment) > reach) return null;
  const value = series.mean[at];
  if (value === null || value === undefined || series.q[at] === BAD) return { at, t: series.t[at], value: null, q: BAD };
  return { at, t: series.t[at], value, q: series.q[at] };
}

/** Lowest, mean of the means and highest within a window; null where nothing is known. */
export function summary(series, { from, to }) {
  if (!series) return null;
  let [low, high, sum, count] = [Infinity, -Infinity, 0, 0];
  for (let at = Math.max(0, indexAt(series.t, from - 1)); at < series.t.length && series.t[at] <= to; at += 1) {
    const mean = series.mean[at];
    if (series.t[at] < from || mean === null || mean === undefined || series.q[at] === BAD) continue;
    low = Math.min(low, series.min[at] ?? mean);
    high = Math.max(high, series.max[at] ?? mean);
    sum += mean;
    count += 1;
  }
  return count ? { low, mean: sum / count, high } : null;
}

/** Stretches of one quality within a series, drawn as a strip below the plot. After a bad value nothing is known until
 * `now`: a lost port sends no further samples. */
export function stretches(series, now) {
  const found = [];
  if (!series) return found;
  series.t.forEach((t, at) => {
    const q = series.mean[at] === null || series.mean[at] === undefined ? BAD : series.q[at];
    const last = found.at(-1);
    if (last) last.to = t;
    if (!last || last.q !== q) found.push({ from: t, to: t, q });
  });
  const newest = found.at(-1);
  if (newest?.q === BAD) newest.to = Math.max(newest.to, now);
  return found.filter((stretch) => stretch.q !== GOOD);
}

/** Typical distance of two samples in ms. */
export function step(series) {
  const t = series?.t ?? [];
  return t.length < 2 ? 1000 : (t.at(-1) - t[0]) / (t.length - 1);
}
