// Dialog to shelve an alarm, or a group of equal ones, for a time, with a reason for the next shift.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api } from "../api.js";
import { ReasonField, isLongEnough } from "../control/reason-field.js";
import { Choice, Dialog, FormEnd, useRequest } from "../ui.js";
import { groupSubject, shelveAll, subjectNames } from "./alarm-groups.js";

const MINUTES = [15, 60, 240, 480, 1440];

export function ShelveDialog({ alarms, onClose }) {
  const [alarm] = alarms;
  const [minutes, setMinutes] = useState(60);
  const [reason, setReason] = useState("");
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    const shelve = alarms.length > 1 ? () => shelveAll(alarms, minutes, reason.trim())
      : () => api.post(`/alarms/${encodeURIComponent(alarm.id)}/shelve`, { minutes, reason: reason.trim() });
    if (await execute(shelve)) onClose();
  };
  const title = alarms.length > 1 ? t("page.shelve_title_all", { n: alarms.length }) : t("page.shelve_title");
  const subject = alarms.length > 1 ? groupSubject(alarms) : subjectNames(alarms);
  return html`<${Dialog} title=${title} onClose=${onClose}>
    <p><strong>${localized(alarm.title)}</strong>${subject && t("page.colon") + subject}</p><p>${t(alarms.length > 1 ? "page.shelve_how_all"
      : "page.shelve_how")}</p>
    <form class="stack" onSubmit=${send}>
      <${Choice} label=${t("page.shelve_for")} value=${minutes} onChange=${setMinutes}
        options=${MINUTES.map((choice) => [choice, t(`page.minutes_${choice}`)])} />
      <${ReasonField} label=${t("page.reason")} help=${t("page.reason_help")} value=${reason} onChange=${setReason} data-first />
      <${FormEnd} error=${error} onClose=${onClose} submit=${t("page.shelve")} disabled=${busy || !isLongEnough(reason)} />
    </form><//>`;
}
