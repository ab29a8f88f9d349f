// Present fault of a drive with its cause, its remedy and its reset, and the drive's other alarms. Their place is reserved:
// a trip or an alarm moves no button.
import { html, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { activeAlarmsOf, hasOnlyClearedAlarms, openAlarms } from "../alarms/alarm-list.js";
import { PriorityMark } from "../alarms/alarm-state.js";
import { api, drivePath } from "../api.js";
import { NO_VALUE } from "../format.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { href } from "../router.js";
import { may } from "../session.js";
import { Button, Dialog, ErrorNote, OutcomeNote, useRequest, withCommands } from "../ui.js";
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

function Fault({ view, alarms }) {
  const [isOpen, setOpen] = useState(false);
  const [execute, busy, error, result, clear] = useRequest();
  const { fault } = view;
  const incident = openAlarms().find((alarm) => alarm.drive === view.id && alarm.incident)?.incident;
  const why = controlBlocker(view) ?? (view.start_inhibited ? t("page.reset_inhibited") : null);
  const note = may("operate") ? why ?? t("page.reset_note") : null;
  const others = alarms.filter((alarm) => alarm.kind !== "fault");
  return html`<div class="active-fault"><${Icon} name="fault" size=${40} /><div class="what"><h2>
      <${FaultTitle} fault=${fault} /></h2>
      ${adviceOf(fault).map(([name, text]) => html`<p key=${name}>${name}${t("page.colon")}<b>${text}</b></p>`)}</div>
    <div class="do"><div class="row">
      ${may("operate") && html`<${Button} disabled=${why !== null} busy=${busy} data-do="reset"
        onClick=${() => execute(() => api.post(drivePath(view.id, "/reset")))}>${t("page.reset")}<//>`}
      <${Button} onClick=${() => setOpen(true)} data-do="remedy">${t("page.fault_details")}…<//>
      ${incident && html`<a class="button" data-do="incident" href=${href("incidents", incident)}>${t("page.open_incident")}</a>`}
      </div>${(note || others.length > 0) && html`<p class="small">${others.length > 0 && html`<${OtherAlarms} alarms=${others} /> `}${note}</p>`}</div>
    ${(error || result?.outcome) && html`<div class="fault-outcome"><${ErrorNote} error=${error} />
      <${OutcomeNote} outcome=${result?.outcome} />
      <${Button} kind="quiet" icon="close" onClick=${clear} aria-label=${t("page.close")} /></div>`}</div>
    ${isOpen && html`<${FaultDialog} fault=${fault} note=${note} incident=${incident} onClose=${() => setOpen(false)} />`}`;
}

const AlarmsLink = ({ children, ...rest }) => html`<a href=${href("alarms")} ...${rest}>${children}</a>`;

/** Other alarms of a tripped drive: the title of the first one, and the number of the others. */
function OtherAlarms({ alarms: [first, ...rest] }) {
  return html`<${Icon} name="warning" size=${16} /> <${AlarmsLink}>${localized(first.title)}${rest.length > 0
    && ` ${t("page.more_alarms", { n: rest.length })}`}<//>`;
}

function DriveAlarms({ alarms: [first, ...rest] }) {
  return html`<p class="drive-alarm"><${PriorityMark} priority=${first.priority} />
    <span class="what"><${AlarmsLink}>${localized(first.title)}<//>
    ${t("page.colon")}${withCommands(localized(first.text))}</span>
    ${rest.length > 0 && html`<${AlarmsLink} class="more">${t("page.more_alarms", { n: rest.length })}<//>`}</p>`;
}

function NoFault({ view, alarms }) {
  const isKnown = isLive.value && view.presence === "online" && view.state !== "unknown";
  const text = isKnown ? t("page.no_present_fault") : t("page.fault") + t("page.colon") + t("page.not_known");
  return html`<div class="no-fault soft"><p><${Icon} name=${isKnown ? "check" : "unknown"} /><span>${text}${isKnown && hasOnlyClearedAlarms(view.id)
    && html`<br /><a href=${href("alarms")}>${t("page.alarms_to_acknowledge")}</a>`}</span></p>
    ${alarms.length > 0 && html`<${DriveAlarms} alarms=${alarms} />`}</div>`;
}

/** Place of the fault and of the alarms; of a drive that reports neither state nor fault it is a line for its alarms. */
export function CurrentFault({ view }) {
  const alarms = activeAlarmsOf(view.id);
  const isFaulty = view.fault || view.state === "fault";
  if (!isFaulty && view.state === "unknown" && !view.capabilities.includes("status")) {
    return html`<section class="alarm-place" aria-label=${t("page.nav_alarms")}>${alarms.length > 0
      ? html`<${DriveAlarms} alarms=${alarms} />` : html`<p class="soft">${t("page.no_drive_alarm")}</p>`}</section>`;
  }
  return html`<section class="fault-place" aria-label=${t("page.fault")}>
    ${isFaulty ? html`<${Fault} view=${view} alarms=${alarms} />` : html`<${NoFault} view=${view} alarms=${alarms} />`}</section>`;
}
