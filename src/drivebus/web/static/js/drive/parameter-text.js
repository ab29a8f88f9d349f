// Range and values of a parameter, for the table of parameters and the review of changes.
import { html } from "../lib.js";
import { localized } from "../i18n.js";
import { NO_VALUE, number } from "../format.js";

/** More choices are folded below their range. */
const MAX_UNFOLDED_CHOICES = 4;

/** Range of a parameter: its least and greatest value, else the first and the last of its choices. */
export function rangeText({ minimum, maximum, choices }) {
  if (minimum !== null || maximum !== null) return `${number(minimum)} … ${number(maximum)}`;
  const raws = Object.keys(choices);
  return raws.length > 0 ? `${raws[0]} … ${raws.at(-1)}` : NO_VALUE;
}

/** Choices of a parameter by name, of a parameter without choices its range. */
export function Range({ parameter }) {
  const choices = Object.entries(parameter.choices);
  if (choices.length === 0) return rangeText(parameter);
  const names = html`<ul class="plain choice-names">${choices.map(([raw, text]) => html`<li key=${raw}>${raw} ${localized(text)}</li>`)}</ul>`;
  if (choices.length > MAX_UNFOLDED_CHOICES) {
    return html`<details class="more"><summary>${rangeText(parameter)}</summary>${names}</details>`;
  }
  return parameter.choices_complete ? names : html`${rangeText(parameter)}${names}`;
}

/** A value with the choice's text where it has one. */
export function valueText(parameter, value, raw) {
  const text = parameter.choices[String(raw ?? value)];
  return text ? `${number(raw ?? value)} ${localized(text)}` : number(value);
}
