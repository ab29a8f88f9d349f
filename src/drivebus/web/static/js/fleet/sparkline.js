// Sparkline of a drive's main signal, and its bar between the limits.
import { html, useComputed, useEffect, useMemo, useRef, useSignalEffect } from "../lib.js";
import { t } from "../i18n.js";
import { number } from "../format.js";
import { readingWithoutAge } from "../readings.js";
import { signalName } from "../signal-names.js";
import { isLive, tickingServiceNow } from "../live.js";
import { drive } from "../store.js";
import { RecentValues, mainSignal, watchTile } from "./recent-values.js";
import { HEIGHT, POINT_COUNT, POINT_MS, WIDTH, paths, pointNumber, rangeOf } from "./spark-points.js";

const MINUTES = (POINT_COUNT * POINT_MS) / 60_000;

/** Tiles advance at different moments, so that not all are redrawn in one frame of the screen. */
const phaseOf = (id) => ([...id].reduce((sum, letter) => sum * 31 + letter.charCodeAt(0), 7) % 10) * (POINT_MS / 10);

/** Scale of a sparkline: the limits of a frequency, else its own range. */
function scaleOf(view, unit, range) {
  if (unit !== "Hz") return range;
  return { low: Math.min(0, range.low), high: Math.max(view.maximum_hz, range.high) };
}

export function Sparkline({ id }) {
  const host = useRef(null);
  const recent = useMemo(() => new RecentValues(id), [id]);
  const phase = useMemo(() => phaseOf(id), [id]);
  const end = useComputed(() => pointNumber(tickingServiceNow() - phase));
  const drawing = useComputed(() => {
    if (!recent.isInView.value) return null;
    recent.answers.value;
    isLive.value;
    const view = drive(id).peek();
    const name = mainSignal(view);
    // The point of the present is drawn when its five seconds are over.
    const range = rangeOf(recent.points, end.value);
    const unit = view?.signals?.[name]?.unit ?? "";
    const words = { name: name && signalName(name), n: MINUTES };
    if (!range) return { good: "", uncertain: "", text: t("page.spark_unknown", words) };
    const known = { low: number(range.low, unit), high: number(range.high, unit), unit };
    return { ...paths(recent.points, end.value, scaleOf(view, unit, range)), text: t("page.spark", { ...words, ...known }) };
  });
  useEffect(() => watchTile(host.current, recent), [recent]);
  useSignalEffect(() => { recent.add(drive(id).value); });
  useSignalEffect(() => {
    if (isLive.value) recent.reload();
    else recent.add(drive(id).peek());
  });
  const { good = "", uncertain = "", text } = drawing.value ?? {};
  return html`<span class="spark" ref=${host} role="img" aria-label=${text} title=${text}>
    <svg viewBox=${`0 -1.5 ${WIDTH} ${HEIGHT + 3}`} preserveAspectRatio="none" aria-hidden="true" focusable="false">
      <path class="good" d=${good} /><path class="uncertain" d=${uncertain} /></svg></span>`;
}

const shareOf = (hertz, view) => Math.min(1, Math.max(0, hertz / view.maximum_hz)).toFixed(3);

/** Bar of the output frequency between 0 and the upper limit, with marks of the lower limit and the setpoint. The value
 * itself stands beside it as text. */
export function LimitBar({ view }) {
  const found = readingWithoutAge(view, "output_frequency");
  if (!found || !(view.maximum_hz > 0)) return null;
  const isKnown = typeof found.value === "number" && found.quality !== "bad";
  const isOver = isKnown && found.value > view.maximum_hz;
  const text = t("page.limits_now", { minimum_hz: view.minimum_hz, maximum_hz: view.maximum_hz });
  const width = (hertz) => ({ width: `${100 * shareOf(hertz, view)}%` });
  return html`<span class=${`limitbar ${isKnown ? "" : "unknown"} ${isOver ? "over" : ""}`} role="img" aria-label=${text} title=${text}>
    ${view.minimum_hz > 0 && html`<span class="minimum" style=${width(view.minimum_hz)}></span>`}
    ${isKnown && html`<span class="fill" style=${{ transform: `scaleX(${shareOf(found.value, view)})` }}></span>`}
    ${view.commanded_hz !== null && html`<span class="setpoint" style=${{ left: width(view.commanded_hz).width }}></span>`}</span>`;
}
