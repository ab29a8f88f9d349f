// A start in two steps: the first gets an arm token from the server, the second starts with it before it expires.
// Every start of a motor on the page begins with such a token; a jog has its own second step.
import { html, useEffect, useId, useRef, useState } from "../lib.js";
import { t } from "../i18n.js";
import { Button, ErrorNote, Notice, useRequest } from "../ui.js";
import { nowMs } from "../store.js";
import { now } from "../live.js";

/** Options of a request that starts a drive: it is answered after the reads that confirm the start. */
export const START_OPTIONS = { timeout_ms: 60_000 };

/**
 * Arm token of a start, which expires: `{armed, left_s, arm, disarm, run, busy, error, clear}`. `request` gets one from the
 * server; `run` is that of `useRequest`, for the request that uses the token.
 */
export function useArmToken(request) {
  const [run, busy, error, , clear] = useRequest();
  const [armed, setArmed] = useState(null);
  const arm = async () => {
    // Counted from the request: the server counts from its answer, which is later.
    const requestedAt = nowMs();
    const found = await run(request);
    if (found) setArmed({ token: found.arm_token, until: requestedAt + found.expires_s * 1000 });
  };
  const left_s = armed ? Math.floor((armed.until - now.value) / 1000) : 0;
  return { armed, left_s, arm, disarm: () => setArmed(null), run, busy, error, clear };
}

/**
 * @param arm the first step: a promise of {arm_token, expires_s}
 * @param act the second step, given the arm token
 * @param first, second texts of the two buttons
 * @param title of the second step
 * @param why reason of a disabled start, beside its button
 * @param children description of the start, shown between the steps
 */
export function ArmStart({
  arm, act, first, second, title = t("page.step_two"), disabled, why, children, onDone, kind = "main",
}) {
  const { armed, left_s, arm: begin, disarm, run, busy, error, clear } = useArmToken(arm);
  const confirm = useRef(null);
  const note = useId();
  const isVoid = disabled || (armed !== null && left_s <= 0);

  // Focus the text, not the button: a second press of the same key must not start the motor.
  useEffect(() => { if (armed) confirm.current?.focus(); }, [armed]);
  useEffect(() => { if (armed && isVoid) disarm(); }, [armed, isVoid]);

  const go = async () => {
    const { token } = armed;
    disarm();
    const found = await run(() => act(token));
    if (found) onDone?.(found);
  };
  const cancel = () => { disarm(); clear(); };
  const key = (event) => { if (event.key === "Escape") cancel(); };

  // The effect comes after the screen was drawn: a void start offers no second button until then either.
  if (!armed || isVoid) {
    return html`<div class="stack"><div class="row"><${Button} kind=${kind} disabled=${disabled} busy=${busy}
      onClick=${begin} data-step="first" aria-describedby=${why ? note : undefined}>${first}<//>
      ${why && html`<span class="hint" id=${note}>${why}</span>`}</div><${ErrorNote} error=${error} /></div>`;
  }
  return html`<div ref=${confirm} class="confirm" tabindex="-1" onKeyDown=${key}>
    <${Notice} kind="warning" live title=${title}>${children}<//><div class="row"><${Button} kind="main"
      onClick=${go} data-step="second">${t("page.step_two_left", { action: second, s: Math.max(0, left_s) })}<//>
      <${Button} onClick=${cancel}>${t("page.cancel")}<//></div></div>`;
}
