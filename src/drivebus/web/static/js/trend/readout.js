// Sample of a line at a moment, as the table and the tooltip of a trend show it.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { NO_VALUE, number } from "../format.js";
import { BAD, UNCERTAIN } from "../quality.js";
import { step, valueAt } from "./columns.js";
import { isWhole, isWord } from "./lines.js";

/** Longest distance of a sample from a moment to be its value, in typical distances of two samples. */
const MAX_REACH_STEPS = 3;

/** Sample of a line's series at a moment, null where none is near. A point that stands for several values of a word has
 * none. */
export function sampleAt(line, series, moment) {
  const found = valueAt(series, moment, Math.max(1500, MAX_REACH_STEPS * step(series)));
  const isMixed = found && isWord(line) && isWhole(series) && series.min[found.at] !== series.max[found.at];
  return isMixed ? { ...found, value: null } : found;
}

/** A sample as text, marked where it is uncertain; a dash where no value is known. */
export function sampleText(found, unit, withUnit = false) {
  if (!found || found.value === null) return html`<span title=${found?.q === BAD
    ? t("page.not_known") : undefined}>${NO_VALUE}</span>`;
  const doubt = found.q === UNCERTAIN;
  return html`<span class=${doubt ? "uncertain" : ""}>${number(found.value, unit)}${withUnit && unit ? ` ${unit}` : ""}
    ${doubt && html` <abbr title=${t("page.uncertain")}>?</abbr>`}</span>`;
}
