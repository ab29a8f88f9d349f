// Markers of commands, faults and alarms in a chart, strips where a value was not good, and the states of a drive.

import { BAD } from "../quality.js";

/** Each kind has its own shape, never only a colour. */
const SHAPES = { command: triangle, stop: square, fault: cross, alarm: diamond, other: dot };
const STRIP_PX = 4;
const STATE_PX = 16;
/** Place of the row of states above the plot. */
export const STATES_PX = STATE_PX + 10;
/** Width of a marker's number with its distance; nearer to the right edge it is on the marker's left. */
const COUNT_PX = 24;

export function drawEvents(plot, { markers, strips, states }, colours) {
  const { ctx } = plot;
  const ratio = devicePixelRatio;
  ctx.save();
  states.forEach((state) => drawState(plot, state, colours, ratio));
  ctx.beginPath();
  ctx.rect(plot.bbox.left, plot.bbox.top, plot.bbox.width, plot.bbox.height);
  ctx.clip();
  strips.forEach((strip, row) => drawStrip(plot, strip, row, colours, ratio));
  for (const group of clustered(plot, markers, 24 * ratio)) drawMarker(plot, group, colours, ratio);
  ctx.restore();
}

/** Merge markers nearer to each other than a finger's width into one with their number; at the right edge, where the number
 * is on the left, nearer than the numbers of both. */
function clustered(plot, markers, width) {
  const groups = [];
  for (const marker of markers) {
    const x = plot.valToPos(marker.t, "x", true);
    if (x < plot.bbox.left - width || x > plot.bbox.left + plot.bbox.width + width) continue;
    const last = groups.at(-1);
    if (last && x - last.x < (isAtEdge(plot, x) ? 2 : 1) * width) last.markers.push(marker);
    else groups.push({ x, markers: [marker] });
  }
  return groups;
}

const isAtEdge = (plot, x) => x > plot.bbox.left + plot.bbox.width - COUNT_PX * devicePixelRatio;

/** Kinds by severity: the most severe of a group gives its shape. */
const SEVERITY = ["fault", "alarm", "stop", "command", "other"];

function drawMarker(plot, { x, markers }, colours, ratio) {
  const kind = SEVERITY.find((name) => markers.some((marker) => marker.shape === name)) ?? "other";
  const { ctx } = plot;
  const top = plot.bbox.top;
  ctx.strokeStyle = ctx.fillStyle = kind === "fault" || kind === "alarm" ? colours.fault : colours.mark;
  ctx.lineWidth = ratio;
  ctx.setLineDash([2 * ratio, 3 * ratio]);
  ctx.beginPath();
  ctx.moveTo(Math.round(x), top + 12 * ratio);
  ctx.lineTo(Math.round(x), top + plot.bbox.height);
  ctx.stroke();
  ctx.setLineDash([]);
  ctx.lineWidth = 2 * ratio;
  SHAPES[kind](ctx, x, top + 7 * ratio, 4.5 * ratio);
  if (markers.length > 1) {
    const isLeft = isAtEdge(plot, x);
    ctx.font = `${11 * ratio}px ${colours.font}`;
    ctx.textAlign = isLeft ? "right" : "left";
    ctx.textBaseline = "middle";
    ctx.fillText(String(markers.length), x + (isLeft ? -7 : 7) * ratio, top + 7 * ratio);
  }
}

/** A stretch of one state with its word, above the plot. */
function drawState(plot, { from, to, isAlarm, text }, colours, ratio) {
  const { ctx } = plot;
  const [left, right] = [plot.bbox.left, plot.bbox.left + plot.bbox.width];
  const begin = Math.max(left, plot.valToPos(from, "x", true));
  const end = Math.min(right, plot.valToPos(to, "x", true));
  if (end <= begin) return;
  const [y, height] = [plot.bbox.top - (STATE_PX + 3) * ratio, STATE_PX * ratio];
  ctx.fillStyle = isAlarm ? colours.fault : colours.grid;
  ctx.fillRect(begin, y, Math.max(ratio, end - begin - ratio), height);
  ctx.font = `${11 * ratio}px ${colours.font}`;
  ctx.textAlign = "left";
  ctx.textBaseline = "middle";
  ctx.fillStyle = isAlarm ? colours.onFault : colours.mark;
  const words = text();
  if (ctx.measureText(words).width + 8 * ratio <= end - begin) ctx.fillText(words, begin + 4 * ratio, y + height / 2);
}

function drawStrip(plot, { stretches, hue }, row, colours, ratio) {
  const { ctx } = plot;
  const [left, right] = [plot.bbox.left, plot.bbox.left + plot.bbox.width];
  const y = plot.bbox.top + plot.bbox.height - (row + 1) * (STRIP_PX + 1) * ratio;
  ctx.fillStyle = colours.lines[hue % colours.lines.length];
  for (const { from, to, q } of stretches) {
    const x = Math.max(left, plot.valToPos(from, "x", true));
    const end = Math.min(right, Math.max(x + ratio, plot.valToPos(to, "x", true)));
    if (end < left || x > right) continue;
    if (q === BAD) ctx.fillRect(x, y, end - x, STRIP_PX * ratio);
    else for (let at = x; at < end; at += 6 * ratio) ctx.fillRect(at, y, Math.min(3 * ratio, end - at),
      STRIP_PX * ratio);
  }
}

function triangle(ctx, x, y, r) {
  ctx.beginPath();
  ctx.moveTo(x, y + r);
  ctx.lineTo(x - r, y - r);
  ctx.lineTo(x + r, y - r);
  ctx.fill();
}

function square(ctx, x, y, r) {
  ctx.fillRect(x - r * 0.8, y - r * 0.8, r * 1.6, r * 1.6);
}

function diamond(ctx, x, y, r) {
  ctx.beginPath();
  ctx.moveTo(x, y - r);
  ctx.lineTo(x + r, y);
  ctx.lineTo(x, y + r);
  ctx.lineTo(x - r, y);
  ctx.fill();
}

function dot(ctx, x, y, r) {
  ctx.beginPath();
  ctx.arc(x, y, r * 0.8, 0, 2 * Math.PI);
  ctx.fill();
}

function cross(ctx, x, y, r) {
  ctx.beginPath();
  ctx.moveTo(x - r, y - r);
  ctx.lineTo(x + r, y + r);
  ctx.moveTo(x + r, y - r);
  ctx.lineTo(x - r, y + r);
  ctx.stroke();
}
