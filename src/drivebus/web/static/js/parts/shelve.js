// Dialog to shelve an alarm for a time, with a reason for the next shift.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { Button, Choice, Dialog, ErrorNote, Field, useRequest } from "../ui.js";
import { driveTitle } from "./titles.js";

const MINUTES = [15, 60, 240, 480, 1440];
const MIN_REASON_LENGTH = 3;

export function ShelveDialog({ alarm, onClose }) {
  const [minutes, setMinutes] = useState(60);
  const [reason, setReason] = useState("");
  const [run, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    if (await run(() => api.post(`/alarms/${encodeURIComponent(alarm.id)}/shelve`, { minutes,
      reason: reason.trim() }))) onClose();
  };
  return html`<${Dialog} title=${t("page.shelve_title")} onClose=${onClose}>
    <p><strong>${alarm.drive && driveTitle(alarm.drive) + t("page.colon")}${localized(alarm.title)}</strong></p><p>${t("page.shelve_how")}</p>
    <form class="stack" onSubmit=${send}>
      <${Choice} label=${t("page.shelve_for")} value=${minutes} onChange=${setMinutes}
        options=${MINUTES.map((one) => [one, t(`page.minutes_${one}`)])} />
      <${Field} label=${t("page.reason")} help=${t("page.reason_help")}><input value=${reason}
        maxlength="500" data-first
        onInput=${(event) => setReason(event.target.value)} /><//>
      <${ErrorNote} error=${error} />
      <div class="row end"><${Button} onClick=${onClose}>${t("page.cancel")}<//>
        <button class="button main" type="submit" disabled=${busy
          || reason.trim().length < MIN_REASON_LENGTH}>${t("page.shelve")}</button></div>
    </form><//>`;
}
