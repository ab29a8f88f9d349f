// Range and values of a parameter as text, for the table of parameters and the review of changes.
import { localized, t } from "../i18n.js";
import { NO_VALUE, number } from "../format.js";

/** Range of a parameter: the number of its choices, else its least and greatest value. */
export function rangeText(parameter) {
  const choices = Object.keys(parameter.choices);
  if (choices.length) return t("page.choices", { n: choices.length });
  if (parameter.minimum === null && parameter.maximum === null) return NO_VALUE;
  return `${number(parameter.minimum)} … ${number(parameter.maximum)}`;
}

/** A value with the choice's text where it has one. */
export function valueText(parameter, value, raw) {
  const text = parameter.choices[String(raw ?? value)];
  return text ? `${number(raw ?? value)} ${localized(text)}` : number(value);
}
