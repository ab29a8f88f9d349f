// Communication-loss test of a drive: its form, its progress and its record.
import { html, useState } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Button, Dialog, ErrorNote, Field, Notice, useRequest } from "../ui.js";
import { number, numberOf } from "../format.js";
import { may } from "../session.js";
import { isLive, tickingServiceNow } from "../live.js";
import { hasControl } from "../control/leases.js";
import { ArmStart, START_OPTIONS } from "../control/arm-start.js";
import { Frequency, frequencyError, highestHz } from "../control/frequency.js";

const TEST_HZ = 10;
const SILENCE_S = [2, 300];
/** Without a communication-loss time that can be read: longer than most drives wait. */
const DEFAULT_SILENCE_S = 18;
const MARGIN_S = 3;

function TestForm({ view, onClose }) {
  const after = view.comm_loss.tested ? null : view.comm_loss.after_s;
  const [hertz, setHertz] = useState(String(Math.min(Math.max(TEST_HZ, view.minimum_hz), highestHz(view))));
  const [silence, setSilence] = useState(String(after ? after + MARGIN_S : DEFAULT_SILENCE_S));
  const frequency_hz = numberOf(hertz);
  const silence_s = numberOf(silence);
  const isWrong = silence_s === null || silence_s < SILENCE_S[0] || silence_s > SILENCE_S[1];
  const [least, most] = SILENCE_S;
  const begin = (arm_token) => api.post(drivePath(view.id, "/comm-loss-test"), { frequency_hz, silence_s, arm_token },
    START_OPTIONS);
  return html`<${Dialog} title=${t("page.comm_loss_test")} onClose=${onClose}><div class="stack">
    <p>${t("page.comm_loss_test_how", { name: titleOf(view) })}</p>
    <${Frequency} label=${t("page.setpoint")} value=${hertz} onChange=${setHertz} limits=${view} />
    <${Field} label=${t("page.comm_loss_silence")} wrong=${isWrong && t("page.comm_loss_silence_range", { least, most })}>
      <span class="withunit"><input inputmode="decimal" autocomplete="off" maxlength="6" value=${silence}
        onInput=${(event) => setSilence(event.currentTarget.value)} /><span>s</span></span><//>
    ${!hasControl(view) && html`<p class="hint">${t("page.not_controlled")}</p>`}
    <${ArmStart} arm=${() => api.post(drivePath(view.id, "/arm"), { purpose: "comm_loss_test" })} act=${begin}
      disabled=${!isLive.value || !hasControl(view) || isWrong || frequencyError(hertz, view) !== null}
      onDone=${onClose} first=${t("page.comm_loss_test")} second=${t("page.comm_loss_test_now")}>
      <p>${t("page.comm_loss_test_ask", { name: titleOf(view), hz: number(frequency_hz, "Hz"), seconds: silence_s })}</p>
      <p>${t("page.comm_loss_test_watch")}</p><//></div><//>`;
}

function Progress({ view, test }) {
  const [execute, busy, error] = useRequest();
  const seconds = test.until_ms === null ? 0 : Math.max(0, Math.ceil((test.until_ms - tickingServiceNow()) / 1000));
  return html`<${Notice} key=${test.phase} kind="warning" live title=${t("page.comm_loss_test")}>
    <p role="timer">${t(`page.comm_loss_phase_${test.phase}`, { seconds })}</p>
    ${test.phase === "silent" && hasControl(view) && html`<${Button} busy=${busy} data-do="read-now"
      onClick=${() => execute(() => api.post(drivePath(view.id, "/comm-loss-test/read")))}>
      ${t("page.comm_loss_stopped_now")}<//>`}<${ErrorNote} error=${error} /><//>`;
}

/** Test that is under way, else what begins one and discards the record of the last one. */
export function CommLossTest({ view }) {
  const [open, setOpen] = useState(false);
  const [execute, busy, error] = useRequest();
  const { test, tested, no_result } = view.comm_loss;
  if (test) return html`<${Progress} view=${view} test=${test} />`;
  return html`${tested && !tested.holds && html`<p class="soft">${t("page.comm_loss_outdated")}</p>`}
    ${no_result && html`<p class="soft">${localized(no_result)}</p>`}
    ${may("limit") && view.capabilities.includes("run") && html`<div class="row"><${Button} disabled=${!isLive.value}
      onClick=${() => setOpen(true)} data-do="test-comm-loss">${t("page.comm_loss_test")}…<//>
      ${tested && html`<${Button} kind="quiet" disabled=${!isLive.value} busy=${busy}
        onClick=${() => execute(() => api.remove(drivePath(view.id, "/comm-loss-test")))}>${t("page.comm_loss_discard")}<//>`}
      </div>`}
    <${ErrorNote} error=${error} />${open && html`<${TestForm} view=${view} onClose=${() => setOpen(false)} />`}`;
}
