// The band from lowest to highest behind a line: each point paints the stretch of time that it stands for. Upright
// boxes on whole pixels: a filled outline of a thousand points takes a processor without graphics 10 times as long.

import { COLUMNS } from "./columns.js";

/** A point beside a gap reaches no further than this share of the plot. */
const MAX_BAND_GAP = 0.02;

/** Draw bands. `isShown(line)`, `fill(line)`: which lines have a band, and its colour. */
export function drawBands(plot, lines, isShown, fill) {
  const { ctx } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
  ctx.clip();
  lines.forEach((line, at) => {
    if (!isShown(line)) return;
    ctx.fillStyle = fill(line);
    drawBand(plot, plot.data[1 + at * COLUMNS], plot.data[2 + at * COLUMNS], plot.series[1 + at * COLUMNS].scale);
  });
  ctx.restore();
}

function drawBand(plot, high, low, scale) {
  const points = visible(plot, high);
  const furthest = plot.bbox.width * MAX_BAND_GAP;
  const x = points.map((at) => plot.valToPos(plot.data[0][at], "x", true));
  points.forEach((at, n) => {
    if (high[at] === low[at] || high[at] === null) return;
    const before = n > 0 ? Math.min(furthest, (x[n] - x[n - 1]) / 2) : 0;
    const after = n < x.length - 1 ? Math.min(furthest, (x[n + 1] - x[n]) / 2) : 0;
    const [left, right] = [Math.round(x[n] - before), Math.round(x[n] + after)];
    const top = Math.round(plot.valToPos(high[at], scale, true));
    const bottom = Math.round(plot.valToPos(low[at], scale, true));
    plot.ctx.fillRect(left, top, Math.max(right - left, before + after === 0 ? 1 : 0), bottom - top);
  });
}

/** Rows of a tag (gaps too) that the window shows; times of other tags are undefined in its columns. */
function visible(plot, high) {
  const [first, last] = plot.series[0].idxs ?? [0, -1];
  const rows = [];
  for (let at = first; at <= last; at += 1) if (high[at] !== undefined) rows.push(at);
  return rows;
}
