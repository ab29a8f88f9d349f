// A trend: signals over time, with zoom, pan, cursors and markers, from a minute to a year.
//
// html`<${Trend} lines=${[{ tag: "fan-1.output_frequency", drive: "fan-1", label: "…", unit: "Hz", hue: 0 }]} />`
import { batch, html, useEffect, useMemo, useRef, useSignalEffect } from "../lib.js";
import { locale, language, t } from "../i18n.js";
import { isLive } from "../live.js";
import { theme } from "../theme.js";
import { drive, serviceNow } from "../store.js";
import { Chart } from "./chart.js";
import { stretches, table } from "./columns.js";
import { Events } from "./events.js";
import { attachGestures } from "./gestures.js";
import { GestureHelp } from "./gesture-help.js";
import { CursorTable } from "./cursor-table.js";
import { addCursors } from "./cursors.js";
import { TrendSource } from "./source.js";
import { loadStylesheet } from "../stylesheet.js";
import { Toolbar } from "./toolbar.js";
import { Tooltip } from "./tooltip.js";
import { TrendState } from "./trend-state.js";
import { axisUnits, isWord, shownUnits } from "./lines.js";
import { drawEvery, fetchEvery } from "./window.js";

await Promise.all([loadStylesheet("/vendor/uplot.css"), loadStylesheet("trend")]);

const LIVE_INTERVAL_MS = 250;

/**
 * @param lines `{tag, drive, label, unit, hue}` each; `hue` 0 to 7 is its colour
 * @param span_s seconds that it follows at first
 * @param window `{from, to}` to begin with instead
 * @param hidden tags whose lines are hidden at first
 * @param source where samples come from; the historian and the live values where left out
 * @param onWindow called with every window, e.g. to export what is shown
 * @param onRemove a line's × was pressed (tag); no × where left out
 */
export function Trend({ lines, span_s = 600, window = null, hidden = [], source: given, onWindow, onRemove, height = 300 }) {
  const trend = useMemo(() => new TrendState(span_s, window, hidden), []);
  const source = useMemo(() => given ?? new TrendSource(), []);
  const host = useRef(null);
  const controller = useMemo(() => new ChartController(trend, source), []);
  const tags = lines.map((line) => line.tag).join(" ");

  useEffect(() => {
    source.choose(lines.map((line) => line.tag), [...new Set(lines.map((line) => line.drive))]);
    source.load(trend.window.peek());
  }, [tags]);
  useEffect(() => controller.mount(host.current, lines, height), [tags, height, language.value, theme.value]);
  useEffect(() => controller.run(), []);
  // Reload what was requested in vain or missed while disconnected.
  useEffect(() => {
    if (isLive.value) source.load(trend.window.peek(), { again: source.fetchedWindow !== null });
  }, [isLive.value]);
  useSignalEffect(() => {
    onWindow?.(trend.window.value, trend.isLive.value);
    source.load(trend.window.value);
    controller.scheduleDraw();
  });
  useSignalEffect(() => { source.series.value; source.markers.value; controller.onSamples(); });
  useSignalEffect(() => { trend.cursors.value; trend.hidden.value; controller.scheduleDraw(); });

  return html`<section class="trend" aria-label=${t("page.trend")}>
    <${Toolbar} trend=${trend} source=${source} />
    <div class="trend-chart"><div class="trend-plot" ref=${host} tabindex="0" role="group"
      aria-label=${t("page.trend_keys")}></div><${Tooltip} trend=${trend} source=${source} lines=${lines} /></div>
    <p class="help">${t("page.legend")}</p>
    <${WithoutAxis} trend=${trend} lines=${lines} /><${GestureHelp} />
    <${CursorTable} trend=${trend} source=${source} lines=${lines} onRemove=${onRemove} />
    <${Events} trend=${trend} source=${source} /></section>`;
}

/** Note that names the shown units without an axis. */
function WithoutAxis({ trend, lines }) {
  const hidden = trend.hidden.value;
  const axes = axisUnits(lines, hidden, trend.recent);
  const others = shownUnits(lines, hidden, trend.recent).filter((unit) => !axes.includes(unit));
  if (others.length === 0) return null;
  return html`<p class="help">${t("page.axes_two", { axes: axes.join(t("language.between_items")),
    others: others.join(t("language.between_items")) })}</p>`;
}

/** Highest frequency of the drives of these lines; null for any other unit, and where no drive is known. */
function highestValue(unit, lines) {
  if (unit !== "Hz") return null;
  const limits = lines.filter((line) => line.unit === unit).map((line) => drive(line.drive).peek()?.maximum_hz ?? 0);
  return Math.max(...limits) || null;
}

/** Chart of a trend and its redrawing, outside of the component's rendering. */
class ChartController {
  constructor(trend, source) {
    this.trend = trend;
    this.source = source;
    this.data = null;
    this.frame = 0;
  }

  /** Replace the plot; returns the function that removes it. */
  mount(host, lines, height) {
    const { trend } = this;
    this.lines = lines;
    this.data = null;
    this.chart = new Chart(host, {
      selected: (window) => trend.show(window, { isStep: true }),
      pointed: (moment, place) => { batch(() => { trend.pointed.value = moment; trend.place.value = place; }); },
      drawn: () => this.placeCursors?.(),
      highest: (unit) => highestValue(unit, lines),
    });
    const plot = this.chart.build(lines, { height, locale: locale(), hasStates: this.source.states?.length > 0 });
    this.placeCursors = addCursors(plot.over, trend);
    const detachGestures = attachGestures(plot.over, host, trend);
    const watch = new ResizeObserver(() => { this.chart.resize(height); });
    watch.observe(host);
    this.scheduleDraw();
    return () => {
      watch.disconnect();
      detachGestures();
      this.chart.destroy();
      this.chart = null;
    };
  }

  /** Follow the present: take live values often, draw when a pixel moves, and reload from the historian at intervals. */
  run() {
    let [drawn, fetched] = [serviceNow(), serviceNow()];
    const timer = setInterval(() => {
      this.source.takeLive();
      if (!this.trend.isLive.peek() || document.hidden) return;
      const [now, span] = [serviceNow(), this.trend.span];
      if (now - drawn < drawEvery(span)) return;
      drawn = now;
      this.data = null;
      this.trend.follow();
      if (now - fetched < fetchEvery(span)) return;
      fetched = now;
      this.source.load(this.trend.window.peek(), { again: true });
    }, LIVE_INTERVAL_MS);
    return () => {
      clearInterval(timer);
      cancelAnimationFrame(this.frame);
      this.source.close();
    };
  }

  onSamples() {
    this.data = null;
    this.scheduleDraw();
  }

  /** Draw in the next frame of the screen, once for any number of calls. */
  scheduleDraw() {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  draw() {
    if (!this.chart) return;
    if (!this.data) this._prepare();
    const { items } = this.source.markers.peek();
    const markers = items.map((event) => ({ t: event.time_ms, shape: event.kind }));
    const hidden = this.trend.hidden.peek();
    this.chart.show(hidden, this.trend.recent);
    this.chart.draw(this.data, this.trend.window.peek(), {
      markers, strips: this.strips.filter(({ tag }) => !hidden.has(tag)), states: this.source.states ?? [],
    });
  }

  _prepare() {
    const series = this.source.seriesWithLive();
    this.data = table(this.lines.map((line) => line.tag), series, this.lines.filter(isWord).map((line) => line.tag));
    this.strips = this.lines
      .map((line) => ({ tag: line.tag, hue: line.hue, stretches: stretches(series[line.tag], this.source.end()) }))
      .filter((strip) => strip.stretches.length);
  }
}
