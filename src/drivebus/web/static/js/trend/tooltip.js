// Tooltip of a trend: time and value of each shown line at the pointer, or where a finger has tapped.
import { html } from "../lib.js";
import { moment } from "../format.js";
import { sampleAt, sampleText } from "./readout.js";

const DISTANCE_PX = 14;

/** Hidden from screen readers: the table below has the same values. */
export function Tooltip({ trend, source, lines }) {
  const at = trend.pointed.value;
  if (at === null) return null;
  source.series.value;
  const series = source.seriesWithLive();
  const { x, width } = trend.place.value;
  const beside = x < width / 2 ? { left: `${x + DISTANCE_PX}px` } : { right: `${width - x + DISTANCE_PX}px` };
  return html`<div class="trend-tip" aria-hidden="true" key=${x < width / 2} style=${beside}><time>${moment(at, true)}</time>
    ${lines.filter((line) => !trend.hidden.value.has(line.tag)).map((line) => html`<div key=${line.tag}>
      <span class=${`swatch hue-${line.hue + 1}`}></span><span>${line.label}</span>
      <b>${sampleText(sampleAt(line, series[line.tag], at), line.unit, true)}</b></div>`)}</div>`;
}
