// A group: progress, start in two steps, setpoint. Its stop is in the stop bar.
import { html, useEffect, useState } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { api, groupPath } from "../api.js";
import { OFF_STATES, TURNING_STATES } from "../drive-states.js";
import { number, numberOf } from "../format.js";
import { isLive } from "../live.js";
import { hasControl, takeControl } from "../control/leases.js";
import { openRequest, secondsLeft, withdrawRequests } from "../control/requests.js";
import { isInOtherWindow, isMine, may } from "../session.js";
import { drive, group, isAbsent } from "../store.js";
import { Icon } from "../icons.js";
import { Button, ErrorNote, Loading, Notice, useRequest, withCommands } from "../ui.js";
import { Frequency, frequencyError, refusesFrequency } from "../control/frequency.js";
import { ArmStart } from "../control/arm-start.js";
import { kindsOf } from "./fleet-filter.js";
import { mergeSentences } from "../control/merge-sentences.js";
import { AskForControlButton, ReleaseButton, WaiverButton } from "../control/selection.js";
import { driveTitle, groupTitle } from "../titles.js";

const GROUP_TIMEOUT_MS = 300_000;

const Merged = ({ ids, names, text, isNamed }) => html`<li title=${ids.map(driveTitle).join(t("language.between_items"))}>${!isNamed && html`<b>
  ${names}</b>${t("page.colon")}`}${withCommands(text)}</li>`;

/** Outcome of each drive of a group; equal ones are one. Without `entries` of drives that have stopped since. */
function Outcomes({ outcomes, entries = Object.entries(outcomes) }) {
  const ended = mergeSentences(entries.filter(([, outcome]) => outcome.status).map(([id, outcome]) => ({
    id, key: outcome.status + localized(outcome.text), text: outcome.text })), Object.keys(outcomes).length).map((merged) => ({
    ...merged, text: t(`page.outcome_${outcomes[merged.ids[0]].status}`) + t("page.colon") + merged.text }));
  const refused = mergeSentences(entries.filter(([, outcome]) => outcome.code).map(([id, outcome]) => ({ ...outcome, id, key: outcome.code })));
  if (entries.length === 0) return null;
  return html`<${Notice} live><ul>${[...ended, ...refused].map((merged) => html`<${Merged} key=${merged.ids[0]} ...${merged} />`)}
    </ul><//>`;
}

/** Outcomes of a start without those that a later trip or stop has made untrue: "the drive reports running". */
const stillTrue = (outcomes) => Object.entries(outcomes).filter(([id, outcome]) => (
  outcome.status !== "confirmed" || !OFF_STATES.includes(drive(id).value?.state)));

/** Button of an action on several drives, one after the other. */
function ActionForAll({ views, act, text, ...rest }) {
  const [execute, busy, error] = useRequest();
  if (views.length === 0) return null;
  const all = () => execute(async () => { for (const view of views) await act(view.id); });
  return html`<div class="stack"><${Button} busy=${busy} onClick=${all} ...${rest}>${t(text, { n: views.length })}<//>
    <${ErrorNote} error=${error} /></div>`;
}

/** Reasons against a start of the group now. A member must report no fault, and a leader's follower must be online. */
function blockersOf({ start_blockers, id, presence, state }, { id: group, leader }) {
  const blockers = start_blockers.map((blocker) => ({ ...blocker, id }));
  if (state === "fault") {
    const params = { drive: driveTitle(id), group: groupTitle(group) };
    blockers.push({ id, key: "plant.member_fault", params, text: t("plant.member_fault", params) });
  }
  if (!leader || id === leader || presence === "online") return blockers;
  const params = { drive: driveTitle(id), group: groupTitle(group), leader: driveTitle(leader) };
  return [...blockers, { id, key: "plant.member_offline", params, text: t("plant.member_offline", params) }];
}

function Blocked({ blockers, total }) {
  if (blockers.length === 0) return null;
  const merged = mergeSentences(blockers, total);
  return html`<${Notice} kind="warning" title=${t("page.group_blocked")}><ul>${merged.map((reason) => html`
    <${Merged} key=${reason.text} ...${reason} />`)}</ul><//>`;
}

/** Open requests of this session for drives of the group, which one press withdraws. */
function OwnRequests({ views }) {
  const [execute, busy, error] = useRequest();
  const open = views.filter((view) => isMine(openRequest(view)));
  if (open.length === 0) return html`<${ErrorNote} error=${error} />`;
  const s = Math.max(...open.map((view) => secondsLeft(view.control_request)));
  return html`<div class="row"><span role="timer">${t("page.control_asked_all", { n: open.length, s })}</span>
    <${Button} busy=${busy} onClick=${() => execute(() => withdrawRequests(open.map(({ id }) => id)))} data-do="withdraw">
      ${t("page.control_withdraw")}<//><${ErrorNote} error=${error} /></div>`;
}

function Controls({ id, views }) {
  const [hertz, setHertz] = useState("");
  const [execute, busy, error, result] = useRequest();
  const [started, setStarted] = useState(null);
  const others = views.filter((view) => !hasControl(view)).length;
  const otherWindow = views.filter((view) => isInOtherWindow(view.lease)).length;
  const found = group(id).value;
  const off = !isLive.value || others > 0 || frequencyError(hertz, found) !== null;
  const blockers = views.flatMap((view) => blockersOf(view, found));
  const blockedCount = new Set(blockers.map((blocker) => blocker.id)).size;
  const silentCount = views.filter(({ presence }) => presence !== "online").length;
  const isSilent = silentCount === views.length;
  const leader = views.find((view) => view.id === found.leader);
  // Without its leader's frequency no drive of a group gets one.
  const cannotSet = off || isSilent || (leader ? refusesFrequency(leader) : views.every(refusesFrequency));
  const turning = views.some((view) => TURNING_STATES.includes(view.state));
  useEffect(() => { if (!turning) setStarted(null); }, [turning]); // at rest the outcome of a start is outdated
  const frequency_hz = numberOf(hertz);
  const send = (rest, body) => api.post(groupPath(id, rest), body, { timeout_ms: GROUP_TIMEOUT_MS });
  const set = () => execute(() => send("/set-frequency", { frequency_hz }));
  return html`<div class="stack">${others > 0 && html`<div class="row">
      <span>${t("page.group_not_controlled", { n: others })}</span>
      <${ActionForAll} views=${views.filter((view) => !view.lease)} act=${takeControl} text="page.lease_take_all" kind="main" />
      <${AskForControlButton} views=${views} /></div>`}
    ${otherWindow > 0 && html`<p class="hint">${t("page.group_other_window", { n: otherWindow })}</p>`}<${OwnRequests} views=${views} />
    <div class="row"><${ReleaseButton} views=${views} />${may("limit") && html`<${WaiverButton} views=${views} />`}</div>
    <${Blocked} blockers=${blockers} total=${views.length} />
    <div class="row"><${Frequency} label=${t("page.group_frequency")} value=${hertz} onChange=${setHertz}
      limits=${found} onEnter=${() => !cannotSet && !busy && set()} disabled=${!isLive.value} />
      <${Button} disabled=${cannotSet} busy=${busy} onClick=${set}>${t("page.set_frequency")}<//></div>
    <${ArmStart} disabled=${off || isSilent || blockedCount > 0}
      why=${isSilent ? t("page.group_not_online") : blockedCount > 0 && t("page.group_start_blocked", { n: blockedCount, of: views.length })}
      first=${t("page.group_start")} second=${t("page.run_now")} title=${t("page.step_two_group")} onDone=${setStarted}
      arm=${() => send("/arm", {})} act=${(arm_token) => send("/start", { frequency_hz, arm_token })}>
      <p>${t("page.group_ask", { name: titleOf(group(id).value), n: views.length, hz: number(frequency_hz, "Hz") })}</p>${silentCount > 0 && html`<p>${t("page.group_ask_silent", { n: silentCount })}</p>`}<p>${t("page.run_watch")}</p>
        <//>
    <${ErrorNote} error=${error} />${result?.outcomes && html`<${Outcomes} outcomes=${result.outcomes} />`}
    ${started?.outcomes && html`<${Outcomes} outcomes=${started.outcomes} entries=${stillTrue(started.outcomes)} />`}</div>`;
}

export function GroupPanel({ id }) {
  const found = group(id).value;
  if (!found && !isAbsent(`groups/${id}`)) return html`<${Loading} />`;
  if (!found) return html`<${Notice} kind="warning">${t("page.no_such_group", { id })}<//>`;
  const views = found.drives.map((name) => drive(name).value).filter(Boolean);
  const leader = found.leader && drive(found.leader).value;
  const progress = found.progress && t("page.group_progress", { n: found.progress.started, of: found.progress.of });
  const countOf = (kind) => views.filter((view) => kindsOf(view).has(kind)).length;
  const [tripped, offline] = [countOf("fault"), countOf("offline")];
  const ratios = Object.entries(found.ratios).map(([name, ratio]) => ` · ${driveTitle(name)} × ${ratio}`);
  return html`<section class="panel stack grouppanel" aria-labelledby="group-title"><div class="row between">
      <h2 id="group-title">${titleOf(found)}</h2><span class="row"><span><b>${t(`page.group_${found.state}`)}</b>${progress && ` · ${progress}`}
        ${!isLive.value && ` ${t("page.state_was")}`}</span>
        ${tripped > 0 && html`<b class="state alarm"><${Icon} name="fault" />${t("page.group_tripped", { n: tripped, of: views.length })}</b>`}
        ${offline > 0 && html`<b class="state alarm"><${Icon} name="silent" />${t("page.group_offline", { n: offline, of: views.length })}</b>`}
      </span></div>
    ${leader && html`<p class="soft">${t("page.group_leader", { name: titleOf(leader) })}${ratios}</p>`}
    ${may("operate") && html`<details><summary>${t("page.group_control")}</summary>
      <${Controls} id=${id} views=${views} /></details>`}</section>`;
}
