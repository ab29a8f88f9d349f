// Marks of an alarm: its state (unacknowledged, acknowledged, cleared but unacknowledged) and its priority.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Icon } from "../icons.js";

/** State of an alarm by shape and word. */
export function AlarmState({ alarm }) {
  const [icon, word] = alarmAppearance(alarm);
  return html`<span class="alarmstate"><${Icon} name=${icon} size=${18} /><b>${t(`page.alarm_${word}`)}</b></span>`;
}

function alarmAppearance({ cleared_ms: cleared, acknowledged_ms: acknowledged }) {
  if (cleared === null) return acknowledged === null ? ["fault", "unacknowledged"] : ["warning", "acknowledged"];
  return acknowledged === null ? ["unknown", "cleared_unacknowledged"] : ["check", "cleared"];
}

const PRIORITY_ICONS = { critical: "fault", high: "warning", medium: "warning", low: "low" };

/** An alarm's priority by shape, word and colour; of a cleared alarm without the colour. */
export function PriorityMark({ priority, cleared = false }) {
  const clearedText = cleared ? t("page.alarm_cleared_unacknowledged") : undefined;
  return html`<span class=${`priority ${priority} ${cleared ? "cleared" : ""}`} title=${clearedText}><${Icon}
    name=${PRIORITY_ICONS[priority] ?? "warning"} size=${18} />
    <span class="word">${t(`page.priority_${priority}`)}</span>${cleared && html`<span class="sr">
      ${clearedText}</span>`}</span>`;
}
