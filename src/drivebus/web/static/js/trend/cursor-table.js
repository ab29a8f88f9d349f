// Table below a chart: each line's value at the pointer and the cursors, and its summary of the window.
import { html, useComputed, useEffect, useRef } from "../lib.js";
import { t } from "../i18n.js";
import { NO_VALUE, reading } from "../format.js";
import { drive } from "../store.js";
import { Value } from "../ui.js";
import { Icon } from "../icons.js";
import { summary } from "./columns.js";
import { duration, moment } from "./labels.js";
import { near, shown } from "./readout.js";
import { isWhole, isWord, valuesOfWord } from "./lines.js";

const WITHIN = ["page.lowest", "page.mean", "page.highest"];
const BETWEEN = ["page.at_a", "page.at_b", "page.difference"];

export function CursorTable({ view, source, lines, onRemove }) {
  const { a, b } = view.cursors.value ?? {};
  const cursors = view.cursors.value !== null;
  const heads = cursors ? BETWEEN : WITHIN;
  const host = useRef(null);
  // The values at A and B are what the cursors were switched on for: they must not stand below the screen.
  useEffect(() => { if (cursors) host.current.scrollIntoView({ block: "nearest" }); }, [cursors]);
  return html`<div class="trend-readout" ref=${host}><table class="data">
    <caption>${cursors ? cursorsText(a, b) : html`<${Where} view=${view} isFixed=${source.isFixed} />`}</caption>
    <thead><tr><th scope="col">${t("page.signal")}</th><th scope="col" class="right">${t("page.value")}</th>
      ${heads.map((head, n) => html`<th key=${head} scope="col" class=${`right more ${n === 1 && !cursors
        ? "mid" : ""}`}>${t(head)}</th>`)}
      ${onRemove && html`<th><span class="sr">${t("page.remove")}</span></th>`}</tr></thead>
    <tbody>${lines.map((line) => html`<${Row} key=${line.tag} line=${line} view=${view} source=${source}
      onRemove=${onRemove} />`)}</tbody></table></div>`;
}

/** Values shown of a word; the older ones are left out. */
const MAX_VALUES = 6;

function valuesText(values) {
  const shownValues = values.slice(-MAX_VALUES).map((value) => value ?? "…");
  return [...(values.length > MAX_VALUES ? ["…"] : []), ...shownValues].join(" → ") || NO_VALUE;
}

function Where({ view, isFixed }) {
  const at = view.pointed.value;
  if (at === null) return t(isFixed ? "page.values_within" : "page.values_now");
  return t("page.values_at", { time: moment(at, true) });
}

function cursorsText(a, b) {
  const apart = duration(b - a, (unit) => t(`page.unit_${unit}`));
  return t("page.cursors_at", { a: moment(a), b: moment(b), apart });
}

function Row({ line, view, source, onRemove }) {
  const figures = useComputed(() => {
    source.series.value;
    const series = source.whole()[line.tag];
    const { a, b } = view.cursors.value ?? {};
    if (a === undefined && isWord(line) && series && isWhole(series)) return valuesOfWord(series, view.window.value);
    if (a === undefined) {
      const found = summary(series, view.window.value);
      return [found?.low, found?.mean, found?.high].map((value) => ({ value: value ?? null }));
    }
    const [one, other] = [near(line, series, a), near(line, series, b)];
    const known = !isWord(line) && one?.value != null && other?.value != null;
    return [one, other, { value: known ? other.value - one.value : null }];
  });
  const hidden = view.hidden.value.has(line.tag);
  const isValues = figures.value.every((one) => one === null || typeof one === "number");
  return html`<tr class=${hidden ? "off" : ""}>
    <th scope="row"><button type="button" class="trend-line" aria-pressed=${hidden ? "false" : "true"}
      onClick=${() => view.toggleLine(line.tag)} title=${t("page.show_line")}>
      <span class=${`swatch hue-${line.hue + 1}`}></span><span>${line.label}</span></button></th>
    <td class="right"><${Now} line=${line} view=${view} source=${source} /></td>
    ${isValues ? html`<td class="right more" colspan="3">${valuesText(figures.value)}</td>`
      : figures.value.map((found, n) => html`<td key=${n} class=${`right more ${n === 1 && !view.cursors.value
        ? "mid" : ""}`}>${shown(found, line.unit)}</td>`)}
    ${onRemove && html`<td><button type="button" class="button quiet" onClick=${() => onRemove(line.tag)}
      aria-label=${t("page.remove_line", { name: line.label })}><${Icon} name="close" size=${16} /></button>
        </td>`}</tr>`;
}

/** Value at the pointer, else at the trip of an incident, else the newest live value. */
function Now({ line, view, source }) {
  const at = view.pointed.value ?? source.trip_ms ?? null;
  if (at !== null) return shown(near(line, source.whole()[line.tag], at), line.unit, true);
  const dot = line.tag.indexOf(".");
  const found = reading(drive(line.drive).value, line.tag.slice(dot + 1));
  return found ? html`<${Value} found=${found} />` : NO_VALUE;
}
