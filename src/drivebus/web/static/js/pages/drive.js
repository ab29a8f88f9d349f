// Page of one drive: values, control, limits, and tabs of its details.
import { html } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Loading, Notice, useLoaded, withWholeNumbers } from "../ui.js";
import { Tabs } from "../tabs.js";
import { href, replaceQuery } from "../router.js";
import { stateOf } from "../readings.js";
import { addSignalNames } from "../signal-names.js";
import { drive, isAbsent } from "../store.js";
import { busTitle, groupTitle } from "../titles.js";
import { motorOf } from "../drive/replaced-drive.js";
import { StateMark } from "../drive/state-mark.js";
import { CommLoss } from "../drive/comm-loss.js";
import { ControlPanel, SAFETY_ID } from "../drive/control.js";
import { CurrentFault } from "../drive/current-fault.js";
import { FaultsTab } from "../drive/faults.js";
import { Limits } from "../drive/limits.js";
import { ParametersTab } from "../drive/parameters.js";
import { ProfileTab } from "../drive/profile.js";
import { StatisticsTab } from "../drive/statistics.js";
import { TrendTab } from "../drive/trend-tab.js";
import { Values } from "../drive/values.js";

function BusLocation({ view }) {
  const groups = view.groups.map((id) => html`${" · "}<a key=${id} href=${href("fleet", null, { group: id })}>${groupTitle(id)}</a>`);
  return html`<p class="soft identity"><code>${view.id}</code> · <a href=${href("buses", view.bus)}>
    ${busTitle(view.bus)}</a>
    ${" · "}${t("page.station", { address: view.address })} · <code>${view.model}
      </code> · ${t("page.grade")}${t("page.colon")}${t(`page.grade_${view.grade}`)}
    ${groups}</p>`;
}

/** Notes on the state, most urgent first. Their place is reserved: one that comes or goes moves no button; a tap shows what is
 * cut off. */
function StateNotes({ view }) {
  const reason = view.state === "unknown" && view.state_reason && (localized(view.unusable_reply?.text) || t(view.state_reason));
  const pending = view.stop_pending && t("page.stop_pending");
  const inhibited = view.start_inhibited && t("page.start_inhibited");
  const notes = [pending, inhibited, reason].filter(Boolean);
  const shown = (note) => note === reason ? note
    : html`<b class="alarmtext" role=${note === pending ? "alert" : null}>${note}</b>`;
  return html`<p class="state-notes soft" tabindex=${notes.length > 0 ? 0 : null} title=${notes.join(" · ")}><span>${
    notes.map((note, n) => html`${n > 0 && " · "}${shown(note)}`)}</span></p>`;
}

function Head({ view }) {
  const known = stateOf(view);
  return html`<header class="drivehead"><div><p><a href=${href("fleet")}>← ${t("page.nav_fleet")}</a></p><h1>
    ${withWholeNumbers(titleOf(view))}</h1>
    <${BusLocation} view=${view} /></div><div class="drivestate"><${StateMark} known=${known} direction=${view.direction}
      size=${40} /><${StateNotes} view=${view} /></div></header>`;
}

async function profileOf(id) {
  const profile = await api.get(drivePath(id, "/profile"));
  addSignalNames(profile.signals);
  return profile;
}

function Details({ view, query }) {
  const [profile, error] = useLoaded(() => profileOf(view.id), [view.id, view.model]);
  const withProfile = (Part) => () => {
    if (profile) return html`<${Part} view=${view} profile=${profile} />`;
    return error ? html`<${Notice} kind="bad">${error.sentence}<//>` : html`<${Loading} />`;
  };
  const tabs = [
    ["trend", t("page.tab_trend"), () => html`<${TrendTab} view=${view} />`],
    ["parameters", t("page.tab_parameters"), withProfile(ParametersTab)],
    ["faults", t("page.tab_faults"), withProfile(FaultsTab)],
    ["statistics", t("page.tab_statistics"), () => html`<${StatisticsTab} id=${view.id} profile=${profile} />`],
    ["profile", t("page.tab_profile"), withProfile(ProfileTab)],
  ];
  return html`<section class="panel drivedetails"><${Tabs} label=${t("page.details")} tabs=${tabs} value=${query.tab ?? "trend"}
    onChange=${(tab) => replaceQuery({ tab })} /></section>`;
}

/** All of one motor: what was entered for it, or read from it, is not left for the next one. */
function DriveParts({ view, query }) {
  return html`<${Head} view=${view} /><${CurrentFault} view=${view} />
    <div class="drivegrid"><${Values} view=${view} /><div class="stack drivecontrol"><${ControlPanel} view=${view} />
      <section class="panel stack" id=${SAFETY_ID} tabindex="-1" aria-labelledby="safety-title"><h2
        id="safety-title">${t("page.safety")}</h2><${CommLoss} view=${view} /><${Limits} view=${view} />
      </section></div><${Details} view=${view} query=${query} /></div>`;
}

export function Page({ id, query }) {
  const view = drive(id).value;
  if (!view && !isAbsent(`drives/${id}`)) return html`<${Loading} />`;
  if (!view) return html`<h1>${id}</h1><${Notice} kind="warning">${t("page.no_such_drive", { id })} <a href=${href("fleet")}>
    ${t("page.nav_fleet")}</a><//>`;
  return html`<${DriveParts} key=${motorOf(view)} view=${view} query=${query} />`;
}
