// A drive's state by shape, word and (only where abnormal) colour.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { Icon } from "../icons.js";

/** State → [icon, tone]. Tones: calm, active, alarm, warn, doubt. */
const APPEARANCES = {
  stopped: ["standing", "calm"], running: ["turning", "active"], accelerating: ["ramp_up", "active"],
  decelerating: ["ramp_down", "active"], braking: ["ramp_down", "active"], jogging: ["turning", "active"],
  paused: ["pause", "warn"], restarting: ["warning", "warn"], not_ready: ["warning", "warn"], fault: ["fault", "alarm"],
  emergency_stopped: ["fault", "alarm"], unknown: ["unknown", "doubt"],
};

/** [icon, tone, word, whether it may be over] of a state from `format.stateOf`. A motion may be over after a stop. */
export function appearanceOf({ state, presence, lost, beforeStop }) {
  if (presence === "never_seen") return ["silent", "doubt", t("page.presence_never_seen"), lost];
  if (presence === "offline") return ["silent", "alarm", t("page.presence_offline"), lost];
  const [icon, tone] = APPEARANCES[state] ?? APPEARANCES.unknown;
  const isOutdated = lost || (tone === "active" && beforeStop);
  return [icon, isOutdated ? "doubt" : tone, t(`drives.state_${state}`), isOutdated];
}

/** `known` is a state from `format.stateOf`; one that may be over is marked. */
export function StateMark({ known, direction, size = 22 }) {
  const [icon, tone, word, isOutdated] = appearanceOf(known);
  const turning = tone === "active" && direction;
  return html`<span class=${`state ${tone}`}><${Icon} name=${icon} size=${size} /><span class="word" title=${word}>${word}</span>
    ${turning && html`<${Icon} name=${direction} size=${size - 4} />
      <span class="sr">${t(`drives.direction_${direction}`)}</span>`}
    ${isOutdated && html`<span class="outdated">${t("page.state_was")}</span>`}</span>`;
}

const PRIORITY_ICONS = { critical: "fault", high: "warning", medium: "warning", low: "low" };

/** An alarm's priority by shape, word and colour; of a cleared alarm without the colour. */
export function PriorityMark({ priority, cleared = false, word = true, size = 18 }) {
  const clearedText = cleared ? t("page.alarm_cleared_unacknowledged") : undefined;
  return html`<span class=${`priority ${priority} ${cleared ? "cleared" : ""}`} title=${clearedText}><${Icon}
    name=${PRIORITY_ICONS[priority] ?? "warning"} size=${size} />
    <span class=${word ? "word" : "sr"}>${t(`page.priority_${priority}`)}</span>${cleared && html`<span class="sr">
      ${clearedText}</span>`}</span>`;
}

/** Badge: what the drive does at a communication loss. */
export function CommLossBadge({ badge }) {
  const calm = badge.kind === "trips";
  const kind = badge.tested?.holds ? `tested_${badge.tested.result}` : badge.kind;
  const words = t(`page.comm_loss_${kind}`, { after: badge.after_s ?? "?" });
  return html`<span class=${`badge ${calm ? "calm" : "warn"}`}><${Icon} name=${calm ? "check" : "warning"} size=${16} />
    <span>${words}${badge.waiver && ` · ${t("page.waived")}`}</span></span>`;
}
