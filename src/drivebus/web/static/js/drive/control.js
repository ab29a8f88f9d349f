// Control panel of one drive: control lease, start in two steps, setpoint, stops, jog, release.
import { html, useEffect, useState } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Button, Choice, ErrorNote, Notice, OutcomeNote, useRequest } from "../ui.js";
import { RUN_STATES, TURNING_STATES } from "../drive-states.js";
import { isLive } from "../live.js";
import { idle, isInOtherWindow, may } from "../session.js";
import { drive, group, idsOf } from "../store.js";
import { driveTitle } from "../titles.js";
import { hasControl } from "../control/leases.js";
import { stop } from "../control/stops.js";
import { moment, number, numberOf } from "../format.js";
import { Frequency, frequencyError, refusesFrequency } from "../control/frequency.js";
import { ArmStart, START_OPTIONS } from "../control/arm-start.js";
import { mergeSentences } from "../control/merge-sentences.js";
import { ControlLease } from "./control-lease.js";
import { JogPanel } from "./jog.js";

/** Reason why only stops are possible now; null where commands are. */
export function controlBlocker(view) {
  if (!isLive.value) return t("page.not_live");
  if (idle.value) return t("page.idle");
  if (!may("operate")) return t("page.view_only");
  if (view.presence !== "online") return t("page.not_online");
  if (hasControl(view)) return null;
  if (isInOtherWindow(view.lease)) return t("page.not_controlled_window");
  return t(view.lease ? "page.not_controlled_other" : "page.not_controlled");
}

function Motion({ view, disabled }) {
  const [hertz, setHertz] = useState(view.commanded_hz === null ? "" : String(view.commanded_hz));
  const [selectedDirection, setSelectedDirection] = useState("forward");
  const [execute, busy, error, result] = useRequest();
  const [started, setStarted] = useState(null);
  const [isOver, setOver] = useState(false);
  const isWrong = frequencyError(hertz, view) !== null;
  const cannotSet = disabled || refusesFrequency(view);
  const turning = TURNING_STATES.includes(view.state);
  const reversible = view.capabilities.includes("reverse");
  const chosen = view.directions.includes(selectedDirection) ? selectedDirection : view.directions[0] ?? "forward";
  // The outcome of a start stays until the motor is at rest, its place until the next start: no button moves meanwhile.
  useEffect(() => { setOver(!turning); }, [turning]);

  const frequency_hz = numberOf(hertz);
  const directions = view.directions.map((direction) => [direction, t(`drives.direction_${direction}`)]);
  const set = () => execute(() => api.post(drivePath(view.id, "/set-frequency"), { frequency_hz }));
  const direction = reversible ? chosen : null;
  const begin = (arm_token) => api.post(drivePath(view.id, "/run"), { frequency_hz, direction, arm_token }, START_OPTIONS);
  const params = { name: titleOf(view), hz: number(frequency_hz, "Hz"), way: t(`drives.direction_${chosen}`) };
  return html`<div class="stack"><${Frequency} label=${t("page.setpoint")} value=${hertz} onChange=${setHertz}
    limits=${view} disabled=${disabled} onEnter=${() => !busy && !cannotSet && set()} />
    <div class="row">${reversible && html`<${Choice} label=${t("page.direction")} value=${chosen} onChange=${setSelectedDirection}
        options=${directions} disabled=${disabled} />`}
      <${Button} kind=${turning ? "main" : "plain"} disabled=${cannotSet || isWrong} busy=${busy} onClick=${set}
        aria-describedby=${view.start_blockers.length > 0 ? BLOCKERS_ID : undefined} data-do="set">${t("page.set_frequency")}<//></div>
    <${ArmStart} arm=${() => api.post(drivePath(view.id, "/arm"))} act=${begin} onDone=${(found) => { setStarted(found); setOver(false); }}
      kind=${turning ? "plain" : "main"} disabled=${disabled || isWrong || view.start_blockers.length > 0}
      first=${t("page.run")} second=${t("page.run_now")}>
      <p>${t(reversible ? "page.run_ask" : "page.run_ask_plain", params)}</p><p>${t("page.run_watch")}</p><//>
    <${ErrorNote} error=${error} /><${OutcomeNote} outcome=${result?.outcome} />
    ${started?.outcome && html`<div class=${isOver ? "past-outcome" : ""}><${OutcomeNote} outcome=${started.outcome} /></div>`}</div>`;
}

/** Stops of this drive; never disabled. They stand first in their panel: what comes or goes below moves none. */
function Stops({ view }) {
  const kinds = ["stop", ...["coast", "quick_stop"].filter((how) => view.capabilities.includes(how))];
  return html`<div class="row" role="group" aria-label=${t("page.bus_stop")}>${kinds.map((how) => html`
    <${Button} key=${how} icon="stop" onClick=${() => stop("drive", view.id, how)} data-do=${how}>
      ${t(`page.how_${how}`)}<//>`)}</div>`;
}

function SingleAction({ path, text, note, disabled, name }) {
  const [execute, busy, error, result] = useRequest();
  return html`<div class="stack"><p>${note}</p><div><${Button} disabled=${disabled} busy=${busy}
    onClick=${() => execute(() => api.post(path))} data-do=${name}>${text}<//></div>
    <${ErrorNote} error=${error} /><${OutcomeNote} outcome=${result?.outcome} /></div>`;
}

const RAMP_HOLD_S = 5;
/** The answer comes after the hold. */
const HOLD_OPTIONS = { timeout_ms: 30_000 };

/** A drive that follows the frequency of this one and turns: it would run on, so the service refuses a pause and a ramp hold. */
function runningFollower({ id }) {
  const led = idsOf("groups").value.map((name) => group(name).value).filter((ledGroup) => ledGroup?.leader === id);
  return led.flatMap((ledGroup) => ledGroup.drives).find((name) => {
    const follower = name !== id && drive(name).value;
    return follower && follower.commanded_hz !== null && TURNING_STATES.includes(follower.state);
  });
}

/** Pause and ramp hold, of the models that have them. A pause ends by the next start. */
function Holds({ view, disabled }) {
  const [execute, busy, error, result] = useRequest();
  const can = (what) => view.capabilities.includes(what);
  if (!can("pause") && !can("hold_ramp")) return null;
  const send = (rest, body) => () => execute(() => api.post(drivePath(view.id, rest), body, HOLD_OPTIONS));
  const follower = runningFollower(view);
  const isOff = disabled || follower || refusesFrequency(view) || !RUN_STATES.includes(view.state);
  const action = (what, text, note, act) => can(what) && html`<div><${Button} disabled=${isOff} busy=${busy} onClick=${act}
    data-do=${what}>${text}<//><p class="hint">${note}</p></div>`;
  return html`<details><summary>${t("page.hold")}</summary><div class="stack">
    ${follower && html`<${Notice} kind="warning">${t("plant.leader_holds", { drive: driveTitle(view.id), follower: driveTitle(follower) })}<//>`}
    ${action("pause", t("page.hold_pause"), t("page.hold_pause_note"), send("/pause"))}
    ${action("hold_ramp", t("page.hold_ramp", { n: RAMP_HOLD_S }), t("page.hold_ramp_note"), send("/hold-ramp", { seconds: RAMP_HOLD_S }))}
    <${ErrorNote} error=${error} /><${OutcomeNote} outcome=${result?.outcome} /></div></details>`;
}

const BLOCKERS_ID = "start-blockers";
export const SAFETY_ID = "safety";

/** Move the reader to the panel of test and waiver, which on a phone is far below. */
function showSafety() {
  const panel = document.getElementById(SAFETY_ID);
  panel.scrollIntoView();
  panel.focus({ preventScroll: true });
}

function StartBlockers({ view }) {
  if (view.start_blockers.length === 0) return null;
  const needsWaiver = may("limit") && view.start_blockers.some(({ key }) => key.startsWith("plant.waiver_"));
  return html`<div id=${BLOCKERS_ID}><${Notice} kind="warning" title=${t("page.blocked")}><ul>${mergeSentences(view.start_blockers.map(
    (blocker) => ({ ...blocker, id: view.id }))).map(({ text }) => html`<li key=${text}>${text}</li>`)}</ul><//></div>
    ${needsWaiver && html`<div><${Button} onClick=${showSafety} data-do="show-safety">${t("page.safety")}…<//></div>`}`;
}

/** Last stop of the drive, with its user and kind, until the next start. Its place is reserved: a start moves no button that is held. */
function LastStop({ view: { last_stop } }) {
  if (!last_stop) return html`<p class="last-stop"></p>`;
  const { kind, actor, time_ms } = last_stop;
  const text = t(`page.last_stop_${kind}`, { actor, time: moment(time_ms) });
  return html`<p class="last-stop soft" data-stop-by=${kind} title=${text}><span>${text}</span></p>`;
}

export function ControlPanel({ view }) {
  const why = controlBlocker(view);
  const disabled = why !== null;
  const canJog = view.capabilities.includes("jog");
  return html`<section class="panel stack control" aria-labelledby="control-title"><h2 id="control-title">
    ${t("page.control")}</h2>
    ${may("stop") && html`<${Stops} view=${view} />`}<${ControlLease} view=${view} />${why && hasControl(view) && html`<${Notice}>${why}<//>`}
    ${why && !hasControl(view) && html`<p class="hint">${why}</p>`}<${StartBlockers} view=${view} />
    <${LastStop} view=${view} />
    ${may("operate") && html`<${Motion} view=${view} disabled=${disabled} />`}
    ${may("operate") && view.start_inhibited && html`<${SingleAction} path=${drivePath(view.id, "/start-inhibit/release")} name="release"
      note=${t("page.release_note")} text=${t("page.release")} disabled=${disabled} />`}
    ${may("operate") && canJog && html`<details><summary>${t("page.jog")}</summary><${JogPanel} view=${view}
      disabled=${disabled || view.start_blockers.length > 0} /></details>`}
    ${may("operate") && html`<${Holds} view=${view} disabled=${disabled} />`}</section>`;
}
