// Gestures of a trend, named below it until the reader closes them.
import { html, signal } from "../lib.js";
import { t } from "../i18n.js";
import { loadPreference, savePreference } from "../preferences.js";

const isOpen = signal(loadPreference("gesture_help", true));
const MOUSE = ["drag", "wheel", "shift", "double", "cursors"];
const TOUCH = ["tap", "finger", "fingers", "cursors"];

const list = (names, device) => html`<ul class=${device}>${names.map((name) => html`<li key=${name}>
  ${t(`page.gesture_${name}`)}</li>`)}</ul>`;

export function GestureHelp() {
  const toggle = (event) => {
    isOpen.value = event.currentTarget.open;
    savePreference("gesture_help", isOpen.value);
  };
  return html`<details class="gestures" open=${isOpen.value} onToggle=${toggle}><summary>${t("page.gestures")}</summary>
    ${list(MOUSE, "mouse")}${list(TOUCH, "touch")}</details>`;
}
