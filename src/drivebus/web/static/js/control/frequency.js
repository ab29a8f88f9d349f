// Input of a frequency: a number and a slider between the limits in force, which are shown.
import { html, useRef } from "../lib.js";
import { t } from "../i18n.js";
import { numberOf } from "../format.js";
import { Field, isComposing } from "../ui.js";

/** Highest frequency that the service accepts: the scale of a setpoint that is not calibrated caps it. */
export const highestHz = ({ maximum_hz, setpoint_cap_hz }) => Math.min(maximum_hz, setpoint_cap_hz ?? maximum_hz);

/** Error of a text as a frequency between the limits, or null. */
export function frequencyError(text, limits) {
  const { minimum_hz } = limits, maximum_hz = highestHz(limits);
  const value = numberOf(text);
  if (value === null) return t("page.not_number");
  if (minimum_hz > maximum_hz) return rangeText(limits);
  if (value < minimum_hz || value > maximum_hz) {
    return maximum_hz < limits.maximum_hz ? rangeText(limits) : t("page.hz_outside", { minimum_hz, maximum_hz });
  }
  return null;
}

/** The frequencies between the limits, and whether a cap is the upper one; limits may contradict each other, as those of the
 * drives of a group. */
function rangeText(limits) {
  const range = { minimum_hz: limits.minimum_hz, maximum_hz: highestHz(limits) };
  const isCapped = range.maximum_hz < limits.maximum_hz;
  if (range.minimum_hz > range.maximum_hz) return t(isCapped ? "page.hz_none_capped" : "page.hz_none", range);
  return t(isCapped ? "page.hz_capped" : "page.hz_limits", range);
}

/** Keys of the start blockers that refuse a frequency, a pause and a ramp hold too: those of every command but a stop. */
export const SETPOINT_BLOCKERS = ["drives.start_inhibited", "drives.foreign_master", "drives.duplicate"];

/** Whether the service refuses a frequency, a pause and a ramp hold for this drive now; the reason is among its start blockers. */
export const refusesFrequency = (view) => view.start_blockers.some(({ key }) => SETPOINT_BLOCKERS.includes(key));

/** `value` is the text of the input; `limits` is a drive or a group; `onEnter` is called for a valid value. */
export function Frequency({ label, value, onChange, onEnter, limits, disabled }) {
  const { minimum_hz } = limits, maximum_hz = highestHz(limits);
  const put = (event) => onChange(event.currentTarget.value);
  const wrong = String(value).trim() === "" ? null : frequencyError(value, limits);
  const key = (event) => {
    if (event.key === "Enter" && !event.repeat && !isComposing(event) && frequencyError(value, limits) === null) onEnter?.();
  };
  // A finger that scrolls the page and begins on the slider has moved it before the browser takes it for a scroll.
  const before = useRef(value);
  return html`<div class="frequency"><${Field} label=${label} wrong=${wrong} help=${rangeText(limits)}><span class="withunit">
      <input inputmode="decimal" autocomplete="off" maxlength="12" value=${value} disabled=${disabled} onInput=${put}
        onKeyDown=${key} aria-invalid=${wrong ? "true" : undefined} /><span>Hz</span></span><//>
    <input type="range" aria-label=${label} step="0.1" min=${minimum_hz} max=${maximum_hz} disabled=${disabled}
      value=${numberOf(value) ?? minimum_hz} onInput=${put} onPointerDown=${() => { before.current = value; }}
      onPointerCancel=${() => onChange(before.current)} /></div>`;
}
