// State of an alarm by shape and word: unacknowledged, acknowledged, cleared but unacknowledged.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Icon } from "../icons.js";

export function AlarmState({ alarm }) {
  const [icon, word] = alarmAppearance(alarm);
  return html`<span class="alarmstate"><${Icon} name=${icon} size=${18} /><b>${t(`page.alarm_${word}`)}</b>
    </span>`;
}

function alarmAppearance({ cleared_ms: cleared, acknowledged_ms: acknowledged }) {
  if (cleared === null) return acknowledged === null ? ["fault", "unacknowledged"] : ["warning", "acknowledged"];
  return acknowledged === null ? ["unknown", "cleared_unacknowledged"] : ["check", "cleared"];
}
