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

/** [icon, tone, word, whether it may be over] of a state from `readings.stateOf`. A motion may be over after a stop. */
export function appearanceOf({ state, presence, unusable, lost, beforeStop }) {
  if (unusable && presence !== "online") return ["warning", "alarm", t("page.presence_unusable"), lost];
  if (presence === "never_seen") return ["silent", "doubt", t("page.presence_never_seen"), lost];
  if (presence === "offline") return ["silent", "alarm", t("page.presence_offline"), lost];
  const [icon, tone] = APPEARANCES[state] ?? APPEARANCES.unknown;
  const isOutdated = lost || (tone === "active" && beforeStop);
  return [icon, isOutdated ? "doubt" : tone, t(`drives.state_${state}`), isOutdated];
}

/** `known` is a state from `readings.stateOf`; one that may be over is marked. */
export function StateMark({ known, direction, size = 22 }) {
  const [icon, tone, word, isOutdated] = appearanceOf(known);
  const turning = tone === "active" && direction;
  return html`<span class=${`state ${tone}`}><${Icon} name=${icon} size=${size} /><span class="word" title=${word}>${word}</span>
    ${turning && html`<${Icon} name=${direction} size=${size - 4} />
      <span class="sr">${t(`drives.direction_${direction}`)}</span>`}
    ${isOutdated && html`<span class="outdated">${t("page.state_was")}</span>`}</span>`;
}
