// Jog: enabled by one press, then turning while a second press is held. A release, leaving the page or a late renewal
// ends it.
import { html, useEffect, useRef, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Icon } from "../icons.js";
import { Button, ErrorNote, Notice } from "../ui.js";
import { numberOf } from "../format.js";
import { useArmToken } from "../control/arm-start.js";
import { Frequency, frequencyError } from "../control/frequency.js";
import { JogSession } from "./jog-session.js";

const HOLD_KEYS = new Set([" ", "Enter"]);

/** Whether a pointer is on the element. No event reports that a captured pointer leaves it. */
function isOver(element, { clientX: x, clientY: y }) {
  const { left, right, top, bottom } = element.getBoundingClientRect();
  return x >= left && x <= right && y >= top && y <= bottom;
}

/** A button that is held: `onHold` at the press, `onRelease` at a release, a lost focus, a hidden page, or when the pointer
 * slips off it. */
function HoldButton({ disabled, held, onHold, onRelease, children, ...rest }) {
  const button = useRef(null);
  useEffect(() => {
    const hidden = () => { if (document.hidden) onRelease(); };
    const outer = [["blur", onRelease], ["hashchange", onRelease], ["pagehide", onRelease]];
    for (const [name, act] of outer) addEventListener(name, act);
    document.addEventListener("visibilitychange", hidden);
    return () => {
      for (const [name, act] of outer) removeEventListener(name, act);
      document.removeEventListener("visibilitychange", hidden);
    };
  }, [onRelease]);
  const press = (event) => {
    if (event.button !== 0) return;
    button.current.setPointerCapture(event.pointerId);
    onHold();
  };
  const move = (event) => { if (!isOver(button.current, event)) onRelease(); };
  const key = (event) => {
    if (!HOLD_KEYS.has(event.key)) return;
    event.preventDefault();
    if (!event.repeat) onHold();
  };
  const keyUp = (event) => { if (HOLD_KEYS.has(event.key)) onRelease(); };
  return html`<button type="button" class=${`button hold ${held ? "held" : ""}`} ref=${button} disabled=${disabled}
    onPointerDown=${press} onPointerMove=${move} onPointerUp=${onRelease} onPointerCancel=${onRelease} onLostPointerCapture=${onRelease} onKeyDown=${key}
      onKeyUp=${keyUp}
    onBlur=${onRelease} onContextMenu=${(event) => event.preventDefault()} ...${rest}>${children}</button>`;
}

function JogStatus({ phase, detail }) {
  if (phase === "lost" && detail.unreachable) return html`<${Notice} kind="bad" live>${t("page.jog_lost")}<//>`;
  if (phase === "lost") return html`<${ErrorNote} error=${detail} />`;
  if (phase === "ended") return html`<${Notice} live title=${t("page.jog_ended")}>${localized(detail?.text)}<//>`;
  if (phase === null) return null;
  return html`<${Notice} kind=${phase === "turning" ? "warning" : "info"} live>${t(`page.jog_${phase}`)}<//>`;
}

/** Input of the jog frequency where the bus can set it; else a note about the drive's own. */
function JogFrequency({ view, ...rest }) {
  if (view.jog_frequency === "drive") return html`<${Notice}>${t("page.jog_own_frequency")}<//>`;
  const label = t(view.jog_frequency === "command" ? "page.jog_frequency_required" : "page.jog_frequency");
  return html`<${Frequency} label=${label} limits=${view} ...${rest} />`;
}

/** `disabled`: the drive may not be commanded now. */
export function JogPanel({ view, disabled }) {
  const { armed, left_s, arm, disarm, busy, error } = useArmToken(() => api.post(drivePath(view.id, "/arm")), disabled);
  const [hertz, setHertz] = useState("");
  const [status, setStatus] = useState({ phase: null, detail: null });
  const [chosen, setChosen] = useState(null);
  const jog = useRef(null);
  const release = useRef(() => jog.current?.release()).current;
  useEffect(() => release, []);
  useEffect(() => { if (disabled) release(); }, [disabled]);

  const isEmpty = hertz.trim() === "";
  const wrong = isEmpty ? view.jog_frequency === "command" : frequencyError(hertz, view) !== null;
  const isHeld = status.phase === "starting" || status.phase === "turning";
  const isEnding = status.phase === "ending"; // its result would be taken for that of the next jog
  const isReady = armed !== null && !isEnding && !wrong;

  const directions = [...view.directions].reverse();
  const hold = (direction) => () => {
    if (!isReady || isHeld) return;
    const frequency_hz = isEmpty ? null : numberOf(hertz);
    disarm();
    setChosen(direction);
    jog.current = new JogSession(view.id, { direction, frequency_hz, arm_token: armed.token }, (phase, detail = null) => {
      setStatus({ phase, detail, remark: jog.current.remark });
    });
    jog.current.run();
  };
  const button = (direction) => html`<${HoldButton} key=${direction} disabled=${!isReady && !isHeld}
    held=${isHeld && chosen === direction} onHold=${hold(direction)}
    onRelease=${release} data-jog=${direction}><${Icon} name=${direction} />${t("page.jog_hold", {
      way: t(`drives.direction_${direction}`) })}<//>`;
  return html`<section class="stack jog" aria-labelledby="jog-title"><h3 class="sr" id="jog-title">${t("page.jog")}</h3><p>
    ${t("page.jog_how")}</p>
    <${JogFrequency} view=${view} value=${hertz} onChange=${setHertz} disabled=${disabled} />
    <div class="row"><${Button} disabled=${disabled || isHeld || isEnding} busy=${busy} onClick=${arm}>
      ${armed ? t("page.jog_enabled", { n: left_s }) : t("page.jog_enable")}<//></div>
    <div class="holds">${directions.map(button)}</div>
    <${ErrorNote} error=${error} />
    ${status.remark && html`<${Notice} kind="bad" live>${localized(status.remark)}<//>`}<${JogStatus} ...${status} /></section>`;
}
