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
 * Arm token of a start: `{armed, left_s, arm, disarm, execute, busy, error, clear}`. `request` gets one from the server, and
 * `execute` is that of `useRequest`, for the request that uses the token. A token that expires is dropped; so is one that is
 * there, or arrives, while the start is `disabled`: it does not wait until the start is possible again.
 */
export function useArmToken(request, disabled) {
  const [execute, busy, error, , clear] = useRequest();
  const [token, setToken] = useState(null);
  const arm = async () => {
    // Counted from the request: the server counts from its answer, which is later.
    const requestedAt = nowMs();
    const found = await execute(request);
    if (found) setToken({ token: found.arm_token, until: requestedAt + found.expires_s * 1000 });
  };
  const disarm = () => setToken(null);
  const left_s = token ? Math.floor((token.until - now.value) / 1000) : 0;
  const isVoid = token !== null && (disabled || left_s <= 0);
  useEffect(() => { if (isVoid) disarm(); }, [isVoid]);
  // The effect comes after the screen was drawn: a void token arms nothing until then either.
  return { armed: isVoid ? null : token, left_s: isVoid ? 0 : left_s, arm, disarm, execute, busy, error, clear };
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
  const { armed, left_s, arm: begin, disarm, execute, busy, error, clear } = useArmToken(arm, disabled);
  const confirm = useRef(null);
  const note = useId();

  // Focus the text, not the button: a second press of the same key must not start the motor.
  useEffect(() => { if (armed) confirm.current?.focus(); }, [armed]);

  const go = async () => {
    const { token } = armed;
    disarm();
    const found = await execute(() => act(token));
    if (found) onDone?.(found);
  };
  const cancel = () => { disarm(); clear(); };
  const key = (event) => {
    if (event.key !== "Escape") return;
    event.stopPropagation(); // the window that it stands in stays open
    cancel();
  };

  if (!armed) {
    return html`<div class="stack"><div class="row"><${Button} kind=${kind} disabled=${disabled} busy=${busy}
      onClick=${begin} data-step="first" aria-describedby=${why ? note : undefined}>${first}<//>
      ${why && html`<span class="hint" id=${note}>${why}</span>`}</div><${ErrorNote} error=${error} /></div>`;
  }
  return html`<div ref=${confirm} class="confirm" tabindex="-1" onKeyDown=${key}>
    <${Notice} kind="warning" live title=${title}>${children}<//><div class="row"><${Button} kind="main"
      onClick=${go} data-step="second">${t("page.step_two_left", { action: second, s: left_s })}<//>
      <${Button} onClick=${cancel}>${t("page.cancel")}<//></div></div>`;
}
