// One uPlot on the page: lines with their band from lowest to highest, a dashed line where a value is uncertain,
// nothing where it is not known, and the strips and markers of draw-events.js.

import "./navigator-language.js"; // before uPlot
import uPlot from "../../../vendor/uplot.js";
import { drawBands } from "./draw-bands.js";
import { COLUMNS, indexAt } from "./columns.js";
import { dayLine, timeLabel } from "./time-labels.js";
import { STATES_PX, drawEvents } from "./draw-events.js";
import { HUES, axisUnits, isWord } from "./lines.js";

const AXIS_PX = 46;
const THICK = 1.75;
const THIN = 1;
/** Half the width of a date label, which is centred on its moment, also without a value axis beside it. */
const HALF_LABEL_PX = 36;

/** Colours and font of a chart from the style sheet, so that a theme changes them too. */
export function colours(host) {
  const style = getComputedStyle(host);
  const named = (name) => style.getPropertyValue(name).trim();
  return {
    ink: named("--soft"), grid: named("--grid"), font: style.fontFamily, fault: named("--critical"), onFault: named("--on-critical"), mark: named("--ink"),
    lines: Array.from({ length: HUES }, (_, at) => named(`--trace-${at + 1}`)),
  };
}

export class Chart {
  /**
   * @param host the element it lives in, whose width it takes
   * @param hooks `{selected({from, to}), pointed(ms | null, {x, width}), drawn(), highest(unit)}`; the last one returns the
   *   highest value of a unit, null where that is not known
   */
  constructor(host, hooks) {
    this.host = host;
    this.hooks = hooks;
    this.extras = { markers: [], strips: [], states: [] };
    this.window = { from: 0, to: 1 };
    this.plot = null;
  }

  /** New lines, language, theme or size: a new plot. `lines` are `{tag, label, unit, hue}`; `hasStates` keeps the place
   * of a row of states. */
  build(lines, { height, locale, hasStates = false }) {
    this.plot?.destroy();
    this.colours = colours(this.host);
    this.lines = lines;
    this.axes = [];
    const width = Math.max(200, this.host.clientWidth);
    this.plot = new uPlot(this._options(lines, width, height, locale, hasStates), this._empty(), this.host);
    return this.plot;
  }

  /** Show a table of `columns.table` in a window. `extras` are `{markers, strips, states}`. */
  draw(data, window, extras) {
    this.window = window;
    this.extras = extras;
    const width = this._isDense(data, window) ? THIN : THICK;
    this.plot.series.forEach((series) => { if (series.width > 0) series.width = width; });
    this.plot.batch(() => {
      if (data !== this.plot.data) this.plot.setData(data, false);
      this.plot.setScale("x", { min: window.from, max: window.to });
    });
  }

  /** Whether there is more than a point for two pixels: a thick line would hide details, and is slow without graphics hardware. */
  _isDense(data, { from, to }) {
    const times = data[0];
    const rows = indexAt(times, to) - indexAt(times, from);
    return rows > this.plot.over.clientWidth / 2;
  }

  _bands(plot) {
    const isShown = (line) => plot.series[1 + this.lines.indexOf(line) * COLUMNS].show;
    drawBands(plot, this.lines, isShown, (line) => translucent(this._hue(line)));
  }

  /** Show all lines except the tags in `hidden`; `recent` are the tags that the user has shown, newest first. */
  show(hidden, recent) {
    this._showAxes(axisUnits(this.lines, hidden, recent));
    this.lines.forEach((line, at) => {
      const isShown = !hidden.has(line.tag);
      if (this.plot.series[1 + at * COLUMNS].show === isShown) return;
      for (let column = 0; column < COLUMNS; column += 1) this.plot.setSeries(1 + at * COLUMNS + column,
        { show: isShown });
    });
  }

  _showAxes(units) {
    if (units.join() === this.axes.join()) return;
    this.axes = units;
    this.plot.axes.slice(1).forEach((axis) => {
      const at = units.findIndex((unit) => scaleOfUnit(unit) === axis.scale);
      axis.show = at >= 0;
      axis.side = at === 1 ? RIGHT : LEFT;
      axis.grid.show = at === 0;
    });
    this.plot.redraw(false, true);
  }

  resize(height) {
    const width = Math.max(200, this.host.clientWidth);
    if (this.plot && (width !== this.plot.width || height !== this.plot.height)) this.plot.setSize({ width, height });
  }

  destroy() {
    this.plot?.destroy();
    this.plot = null;
  }

  _empty() {
    return [[], ...this.lines.flatMap(() => [[], [], [], []])];
  }

  _options(lines, width, height, locale, hasStates) {
    const units = [...new Set(lines.filter((line) => !isWord(line)).map((line) => line.unit))];
    return {
      width, height, ms: 1, legend: { show: false }, padding: [hasStates ? STATES_PX : 10, rightEdge, 0, leftEdge],
      cursor: {
        y: false, points: { size: 7 }, drag: { x: true, y: false, setScale: false },
        dataIdx: nearest,
      },
      scales: Object.fromEntries([["x", { time: true, auto: false }], ...lines.map((line) => [scale(line), { range: this._valueRange(line.unit) }])]),
      axes: [this._timeAxis(locale), ...units.map((unit) => this._valueAxis(unit))],
      series: [{}, ...lines.flatMap((line) => this._series(line))],
      hooks: {
        drawAxes: [(plot) => this._bands(plot)],
        draw: [(plot) => { drawEvents(plot, this.extras, this.colours); this.hooks.drawn?.(plot); }],
        setSelect: [(plot) => this._selected(plot)],
        setCursor: [(plot) => this.hooks.pointed?.(momentAtPointer(plot), this._pointerPlace(plot))],
      },
    };
  }

  _hue(line) {
    return this.colours.lines[line.hue % this.colours.lines.length];
  }

  _series(line) {
    const plain = { scale: scale(line), label: line.label, ...(isWord(line) ? { paths: STEPS } : {}) };
    // The edges only widen the scale; `bands` paints them.
    const edge = { ...plain, stroke: "transparent", width: 0, points: { show: false }, paths: () => null };
    const stroke = this._hue(line);
    return [
      edge, edge,
      { ...plain, stroke, width: THICK, points: { size: 5, filter: isolatedPoints } },
      { ...plain, stroke, width: THICK, dash: [5, 4], points: { show: false } },
    ];
  }

  _timeAxis(locale) {
    return {
      stroke: this.colours.ink, font: this._font(), grid: this._lines(), ticks: this._lines(), space: 72, size: 46,
      values: (plot, splits) => {
        const span = plot.scales.x.max - plot.scales.x.min;
        let [day, time] = ["", ""];
        return splits.map((at) => {
          const [above, below] = [timeLabel(at, span, locale), dayLine(at, span, locale)];
          const [isNewDay, isNewTime] = [below !== day, above !== time];
          [day, time] = [below, above];
          return (isNewTime ? above : "") + (isNewDay && below ? `\n${below}` : "");
        });
      },
    };
  }

  _valueAxis(unit) {
    return {
      scale: scaleOfUnit(unit), side: LEFT, size: AXIS_PX, stroke: this.colours.ink, font: this._font(),
      grid: this._lines(), ticks: this._lines(), space: 34,
      label: unit, labelSize: 18, labelGap: 0, labelFont: this._font(),
      values: (_, splits) => splits.map((value) => tick(value, splits)),
    };
  }

  /** Range from 0; where all values are 0 up to the highest one, or 1: uPlot's own 0 to 100 means nothing in that unit. */
  _valueRange(unit) {
    return (_, low, high) => {
      if (low === null) return [null, null];
      return low === 0 && high === 0 ? [0, this.hooks.highest?.(unit) ?? 1] : uPlot.rangeNum(low, high, VALUE_RANGE);
    };
  }

  _lines() {
    return { stroke: this.colours.grid, width: 1 };
  }

  _font() {
    return `12px ${this.colours.font}`;
  }

  /** Place of the pointer within the host, in pixels. */
  _pointerPlace(plot) {
    return { x: plot.over.offsetLeft + plot.cursor.left, width: this.host.clientWidth };
  }

  _selected(plot) {
    const { left, width } = plot.select;
    if (width < 6) return;
    const [from, to] = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.hooks.selected({ from, to });
  }
}

/** Sides of an axis, as uPlot counts them. */
const [RIGHT, LEFT] = [1, 3];
const STEPS = uPlot.paths.stepped({ align: 1 });
const VALUE_RANGE = { min: { pad: 0.08, soft: 0, mode: 3 }, max: { pad: 0.08, soft: 0, mode: 3 } };
/** Label of a tick, with enough decimals to distinguish it from the next. */
function tick(value, splits) {
  const apart = Math.abs((splits[1] ?? 1) - (splits[0] ?? 0)) || 1;
  return value.toFixed(Math.max(0, Math.min(4, -Math.floor(Math.log10(apart) + 1e-9))));
}

/** Padding of the left edge of an empty chart: uPlot draws no value axis where no value is known. */
const leftEdge = (plot, side, axes) => (axes[side] ? 0 : HALF_LABEL_PX);
const rightEdge = (plot, side, axes) => (axes[side] ? 0 : 12);
const scaleOfUnit = (unit) => `y ${unit}`;
const scale = (line) => scaleOfUnit(isWord(line) ? line.tag : line.unit);
const translucent = (colour) => `color-mix(in srgb, ${colour} 22%, transparent)`;
const momentAtPointer = (plot) => (plot.cursor.left >= 0 ? plot.posToVal(plot.cursor.left, "x") : null);

/** The point under the cursor of a column: the nearest known one, since tags were not read at the same moments. */
function nearest(plot, column, at) {
  const values = plot.data[column];
  for (let away = 0; away < 60; away += 1) {
    if (values[at - away] !== undefined && values[at - away] !== null) return at - away;
    if (values[at + away] !== undefined && values[at + away] !== null) return at + away;
  }
  return at;
}

/** A sample between two gaps has no line: it is drawn as a point, so that it is not lost. */
function isolatedPoints(plot, column, show) {
  if (show) return null;
  const [high, , values, uncertain] = plot.data.slice(column - 2, column + 2);
  const [first, last] = plot.series[0].idxs ?? [0, values.length - 1];
  const isGap = (at) => values[at] === null && (uncertain[at] ?? null) === null;
  const alone = [];
  for (let at = first; at <= last; at += 1) {
    const isKnown = values[at] !== null && values[at] !== undefined;
    if (isKnown && hasGapBeside(high, at, -1, isGap) && hasGapBeside(high, at, 1, isGap)) alone.push(at);
  }
  return alone;
}

/** Whether the neighbour that belongs to this tag is a gap. Times of other tags are undefined in its column of highest values. */
function hasGapBeside(high, at, way, isGap) {
  let other = at + way;
  while (other >= 0 && other < high.length && high[other] === undefined) other += way;
  return other < 0 || other >= high.length || isGap(other);
}
