// Present fault of a drive with its cause, its remedy and its reset. Its place is reserved: a trip moves no button.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { hasOnlyClearedAlarms, openAlarms } from "../alarms/alarm-list.js";
import { api, drivePath } from "../api.js";
import { NO_VALUE } from "../format.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { Button, Dialog, ErrorNote, OutcomeNote, useRequest } from "../ui.js";
import { controlBlocker } from "./control.js";
import { adviceOf, faultText, namesLabel } from "./faults.js";

/** Title of the present fault; of a drive that reports a fault without a code, the word alone. */
function FaultTitle({ fault }) {
  if (!fault) return t("drives.state_fault");
  return html`${!namesLabel(fault) && `${t("page.fault")} `}${faultText(fault)}`;
}

function FaultDialog({ fault, note, incident, onClose }) {
  return html`<${Dialog} title=${html`<${FaultTitle} fault=${fault} />`} onClose=${onClose}><dl class="facts">
    ${adviceOf(fault).map(([name, text]) => html`<dt>${name}</dt><dd>${text}</dd>`)}
    ${fault && html`<dt>${t("page.code")}</dt><dd>${fault.code < 0 ? NO_VALUE : fault.code}</dd>`}</dl>
    ${note && html`<p>${note}</p>`}
    ${incident && html`<div class="row end"><a class="button" href=${href("incidents", incident)}>${t("page.open_incident")}</a></div>`}<//>`;
}

function Fault({ view }) {
  const [isOpen, setOpen] = useState(false);
  const [execute, busy, error, result, clear] = useRequest();
  const { fault } = view;
  const incident = openAlarms().find((alarm) => alarm.drive === view.id && alarm.incident)?.incident;
  const why = controlBlocker(view) ?? (view.start_inhibited ? t("page.reset_inhibited") : null);
  const note = may("operate") ? why ?? t("page.reset_note") : null;
  return html`<div class="active-fault"><${Icon} name="fault" size=${40} /><div class="what"><h2>
      <${FaultTitle} fault=${fault} /></h2>
      ${adviceOf(fault).map(([name, text]) => html`<p key=${name}>${name}${t("page.colon")}<b>${text}</b></p>`)}</div>
    <div class="do"><div class="row">
      ${may("operate") && html`<${Button} disabled=${why !== null} busy=${busy} data-do="reset"
        onClick=${() => execute(() => api.post(drivePath(view.id, "/reset")))}>${t("page.reset")}<//>`}
      <${Button} onClick=${() => setOpen(true)} data-do="remedy">${t("page.fault_details")}…<//>
      ${incident && html`<a class="button" data-do="incident" href=${href("incidents", incident)}>${t("page.open_incident")}</a>`}
      </div>${note && html`<p class="small">${note}</p>`}</div>
    ${(error || result?.outcome) && html`<div class="fault-outcome"><${ErrorNote} error=${error} />
      <${OutcomeNote} outcome=${result?.outcome} />
      <${Button} kind="quiet" icon="close" onClick=${clear} aria-label=${t("page.close")} /></div>`}</div>
    ${isOpen && html`<${FaultDialog} fault=${fault} note=${note} incident=${incident} onClose=${() => setOpen(false)} />`}`;
}

function NoFault({ view }) {
  const isKnown = isLive.value && view.presence === "online" && view.state !== "unknown";
  const text = isKnown ? t("page.no_present_fault") : t("page.fault") + t("page.colon") + t("page.not_known");
  return html`<p class="soft"><${Icon} name=${isKnown ? "check" : "unknown"} /><span>${text}${isKnown && hasOnlyClearedAlarms(view.id)
    && html`<br /><a href=${href("alarms")}>${t("page.alarms_to_acknowledge")}</a>`}</span></p>`;
}

/** Place of the fault; a drive that reports neither state nor fault has none. */
export function CurrentFault({ view }) {
  const isFaulty = view.fault || view.state === "fault";
  if (!isFaulty && view.state === "unknown" && !view.capabilities.includes("status")) return null;
  return html`<section class="fault-place" aria-label=${t("page.fault")}>
    <${isFaulty ? Fault : NoFault} view=${view} /></section>`;
}
