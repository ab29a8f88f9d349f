// Table below a chart: each line's value at the pointer and the cursors, and its summary of the window.
import { html, useComputed, useEffect, useRef } from "../lib.js";
import { t } from "../i18n.js";
import { NO_VALUE, moment, spanText } from "../format.js";
import { reading } from "../readings.js";
import { splitTag } from "../history-tags.js";
import { drive } from "../store.js";
import { Value } from "../ui.js";
import { Icon } from "../icons.js";
import { summary } from "./columns.js";
import { sampleAt, sampleText } from "./readout.js";
import { isWhole, isWord, valuesOfWord } from "./lines.js";

const WINDOW_HEADS = ["page.lowest", "page.mean", "page.highest"];
const CURSOR_HEADS = ["page.at_a", "page.at_b", "page.difference"];

export function CursorTable({ trend, source, lines, onRemove }) {
  const { a, b } = trend.cursors.value ?? {};
  const cursors = trend.cursors.value !== null;
  const heads = cursors ? CURSOR_HEADS : WINDOW_HEADS;
  const host = useRef(null);
  // The values at A and B are what the cursors were switched on for: they must not stand below the screen.
  useEffect(() => { if (cursors) host.current.scrollIntoView({ block: "nearest" }); }, [cursors]);
  return html`<div class="trend-readout" ref=${host}><table class="data">
    <caption>${cursors ? cursorsText(a, b) : html`<${TableCaption} trend=${trend} isFixed=${source.isFixed} />`}</caption>
    <thead><tr><th scope="col">${t("page.signal")}</th><th scope="col" class="right">${t("page.value")}</th>
      ${heads.map((head, n) => html`<th key=${head} scope="col" class=${`right more ${n === 1 && !cursors
        ? "mid" : ""}`}>${t(head)}</th>`)}
      ${onRemove && html`<th><span class="sr">${t("page.remove")}</span></th>`}</tr></thead>
    <tbody>${lines.map((line) => html`<${Row} key=${line.tag} line=${line} trend=${trend} source=${source}
      onRemove=${onRemove} />`)}</tbody></table></div>`;
}

/** Values shown of a word; the older ones are left out. */
const MAX_VALUES = 6;

function valuesText(values) {
  const shownValues = values.slice(-MAX_VALUES).map((value) => value ?? "…");
  return [...(values.length > MAX_VALUES ? ["…"] : []), ...shownValues].join(" → ") || NO_VALUE;
}

function TableCaption({ trend, isFixed }) {
  const at = trend.pointed.value;
  if (at === null) return t(isFixed ? "page.values_within" : "page.values_now");
  return t("page.values_at", { time: moment(at, true) });
}

function cursorsText(a, b) {
  return t("page.cursors_at", { a: moment(a), b: moment(b), apart: spanText(b - a) });
}

function Row({ line, trend, source, onRemove }) {
  const figures = useComputed(() => {
    source.series.value;
    const series = source.seriesWithLive()[line.tag];
    const { a, b } = trend.cursors.value ?? {};
    if (a === undefined && isWord(line) && series && isWhole(series)) return valuesOfWord(series, trend.window.value);
    if (a === undefined) {
      const found = summary(series, trend.window.value);
      return [found?.low, found?.mean, found?.high].map((value) => ({ value: value ?? null }));
    }
    const [atA, atB] = [sampleAt(line, series, a), sampleAt(line, series, b)];
    const known = !isWord(line) && atA?.value != null && atB?.value != null;
    return [atA, atB, { value: known ? atB.value - atA.value : null }];
  });
  const hidden = trend.hidden.value.has(line.tag);
  const isValues = figures.value.every((figure) => figure === null || typeof figure === "number");
  return html`<tr class=${hidden ? "off" : ""}>
    <th scope="row"><button type="button" class="trend-line" aria-pressed=${hidden ? "false" : "true"}
      onClick=${() => trend.toggleLine(line.tag)} title=${t("page.show_line")}>
      <span class=${`swatch hue-${line.hue + 1}`}></span><span>${line.label}</span></button></th>
    <td class="right"><${LineValue} line=${line} trend=${trend} source=${source} /></td>
    ${isValues ? html`<td class="right more" colspan="3">${valuesText(figures.value)}</td>`
      : figures.value.map((found, n) => html`<td key=${n} class=${`right more ${n === 1 && !trend.cursors.value
        ? "mid" : ""}`}>${sampleText(found, line.unit)}</td>`)}
    ${onRemove && html`<td><button type="button" class="button quiet" onClick=${() => onRemove(line.tag)}
      aria-label=${t("page.remove_line", { name: line.label })}><${Icon} name="close" size=${16} /></button>
        </td>`}</tr>`;
}

/** Value at the pointer, else at the trip of an incident, else the newest live value. */
function LineValue({ line, trend, source }) {
  const at = trend.pointed.value ?? source.trip_ms ?? null;
  if (at !== null) return sampleText(sampleAt(line, source.seriesWithLive()[line.tag], at), line.unit, true);
  const [, name] = splitTag(line.tag);
  const found = reading(drive(line.drive).value, name);
  return found ? html`<${Value} found=${found} />` : NO_VALUE;
}
