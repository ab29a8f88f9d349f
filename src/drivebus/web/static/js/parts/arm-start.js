// A start in two steps: the first asks the server for leave, the second, within its seconds, starts. Everything that
// may start a motor goes through here.
import { html, useEffect, useRef, useState } from "../lib.js";
import { t } from "../i18n.js";
import { Button, ErrorNote, Notice, useRequest } from "../ui.js";
import { nowMs } from "../store.js";
import { now } from "../live.js";

/**
 * @param arm asks for the first step: a promise of {arm_token, expires_s}
 * @param act the second step, given the arm token
 * @param first, second texts of the two buttons
 * @param children what will be done, shown between the steps
 */
export function TwoStep({ arm, act, first, second, disabled, children, onDone, kind = "main" }) {
  const [run, busy, error, , forget] = useRequest();
  const [armed, setArmed] = useState(null);
  const confirm = useRef(null);
  const left_s = armed ? Math.floor((armed.until - now.value) / 1000) : 0;
  const over = armed && left_s <= 0;

  // Not to the button: a second press of the same key would start the motor unread.
  useEffect(() => { if (armed) confirm.current?.focus(); }, [armed]);
  useEffect(() => { if (disabled || over) setArmed(null); }, [disabled, over]);

  const begin = async () => {
    // Counted from the asking: the server counts from its answer, which is later.
    const asked = nowMs();
    const found = await run(arm);
    if (found) setArmed({ word: found.arm_token, until: asked + found.expires_s * 1000 });
  };
  const go = async () => {
    const { word } = armed;
    setArmed(null);
    const found = await run(() => act(word));
    if (found) onDone?.(found);
  };
  const cancel = () => { setArmed(null); forget(); };
  const key = (event) => { if (event.key === "Escape") cancel(); };

  if (!armed) {
    return html`<div class="stack"><div><${Button} kind=${kind} disabled=${disabled} busy=${busy} onClick=${begin}
      data-step="first">${first}<//></div><${ErrorNote} error=${error} /></div>`;
  }
  return html`<div ref=${confirm} class="confirm" tabindex="-1" onKeyDown=${key}>
    <${Notice} kind="warning" live title=${t("page.step_two")}>${children}<//><div class="row"><${Button} kind="main"
      onClick=${go} data-step="second">${second} (${Math.max(0, left_s)})<//>
      <${Button} onClick=${cancel}>${t("page.cancel")}<//></div></div>`;
}
