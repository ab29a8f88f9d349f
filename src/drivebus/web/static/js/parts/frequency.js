// A frequency to be entered: a number and a slider between the limits that hold, which are shown.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Field } from "../ui.js";

const STEP_HZ = 0.01;

/** What is wrong with a text as a frequency between the limits, or null. */
export function wrongWith(text, { minimum_hz, maximum_hz }) {
  const value = Number(text);
  if (String(text).trim() === "" || !Number.isFinite(value)) return t("page.hz_not_number");
  if (value < minimum_hz || value > maximum_hz) return t("page.hz_outside", { minimum_hz, maximum_hz });
  return null;
}

/** `value` is the text of the input; `limits` has minimum_hz and maximum_hz. */
export function Frequency({ label, value, onChange, limits, disabled }) {
  const { minimum_hz, maximum_hz } = limits;
  const put = (event) => onChange(event.currentTarget.value);
  const wrong = String(value).trim() === "" ? null : wrongWith(value, limits);
  const range = { min: minimum_hz, max: maximum_hz, disabled, onInput: put };
  const help = t("page.hz_limits", { minimum_hz, maximum_hz });
  return html`<div class="frequency"><${Field} label=${label} wrong=${wrong} help=${help}><span class="withunit">
      <input type="number" inputmode="decimal" step=${STEP_HZ} value=${value} ...${range}
        aria-invalid=${wrong ? "true" : undefined} /><span>Hz</span></span><//>
    <input type="range" aria-label=${label} step="0.1" value=${value === "" ? minimum_hz : value} ...${range} /></div>`;
}
