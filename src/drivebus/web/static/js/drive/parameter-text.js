// Range and values of a parameter, for the table of parameters and the review of changes.
import { html } from "../lib.js";
import { localized, t } from "../i18n.js";
import { NO_VALUE, number } from "../format.js";

/** More choices are folded below their range. */
const MAX_UNFOLDED_CHOICES = 4;

/** Least and greatest value of a parameter. */
export function rangeText({ minimum, maximum }) {
  return minimum === null && maximum === null ? NO_VALUE : `${number(minimum)} … ${number(maximum)}`;
}

/** Range of a parameter, and its choices by name: many are folded, and "…" stands for those that the manual does not name. */
export function Range({ parameter }) {
  const choices = Object.entries(parameter.choices);
  const range = rangeText(parameter);
  if (choices.length === 0) return range;
  const names = html`<ul class="choice-names">${choices.map(([raw, text]) => html`<li key=${raw}>${raw} ${localized(text)}</li>`)}
    ${!parameter.choices_complete && html`<li>…</li>`}</ul>`;
  if (choices.length <= MAX_UNFOLDED_CHOICES) return html`${range !== NO_VALUE && range}${names}`;
  const summary = range === NO_VALUE ? `${choices[0][0]} … ${choices.at(-1)[0]}` : range;
  return html`<details class="more"><summary>${summary}</summary>${names}</details>`;
}

/** A value with the choice's text where it has one. */
export function valueText(parameter, value, raw) {
  const text = parameter.choices[String(raw ?? value)];
  return text ? `${number(raw ?? value)} ${localized(text)}` : number(value);
}

/** Why the value of a parameter is uncertain, on a line of its own. */
export function UncertainNote({ quality, reason }) {
  if (quality !== "uncertain") return null;
  return html`<div class="small doubtful">${t("page.quality_uncertain")}${reason && t("page.colon") + t(reason)}</div>`;
}
