// Components shared by all pages. Texts come in as children or through t().
import { html, useEffect, useId, useLayoutEffect, useRef, useState } from "./lib.js";
import { localized, t } from "./i18n.js";
import { NO_VALUE, duration, number } from "./format.js";
import { Icon } from "./icons.js";
import { isLive } from "./live.js";

/** Ignore the key repeat of Enter: a held key presses a button once. */
export const ignoreRepeat = (event) => { if (event.repeat && event.key === "Enter") event.preventDefault(); };

/** Call `act` for the first press of a double click alone: it has moved another alarm's button under the pointer. */
export const onFirstClick = (act) => ({ detail }) => { if (detail < 2) act(); };

/** Whether a key belongs to an input method, such as the Enter that ends the input of Chinese. Safari reports that one after
 * its end, with this code. */
export const isComposing = ({ isComposing: isUnderWay, keyCode }) => isUnderWay || keyCode === 229;

/** kind: "plain", "main" (the one thing to do here), "quiet", "danger". `busy` shows that an answer is awaited: the button
 * does nothing but keeps the focus, which a disabled one loses. */
export function Button({ kind = "plain", busy = false, disabled = false, icon, children, class: more = "", onClick, ...rest }) {
  return html`<button type="button" class=${`button ${kind} ${more}`} disabled=${disabled}
    aria-busy=${busy ? "true" : undefined} aria-disabled=${busy ? "true" : undefined} onKeyDown=${ignoreRepeat}
    onClick=${busy ? undefined : onClick} ...${rest}>
    ${icon && html`<${Icon} name=${icon} />`}${children}</button>`;
}

/** Label and input (the child) of a value, with its help or its error `wrong`. */
export function Field({ label, help, wrong, children, class: more = "" }) {
  return html`<label class=${`field ${more}`}><span class="label">${label}</span>${children}
    <${FieldNote} help=${help} wrong=${wrong} /></label>`;
}

/** Error of a field, else its help. */
function FieldNote({ id, help, wrong }) {
  if (wrong) return html`<span class="wrong" id=${id} role="alert">${wrong}</span>`;
  return help && html`<span class="help" id=${id}>${help}</span>`;
}

/** A password: hidden until its button is pressed, because a mistyped one cannot be used again. */
export function PasswordField({ label, help, wrong, ...input }) {
  const [shown, setShown] = useState(false);
  const id = useId();
  const note = help || wrong ? `${id}-note` : undefined;
  return html`<div class="field"><label class="label" for=${id}>${label}</label><div class="password"><input ...${input} id=${id}
    type=${shown ? "text" : "password"} spellcheck=${false} autocapitalize="none" aria-describedby=${note} />
    <${Button} icon=${shown ? "eye_off" : "eye"} title=${t("page.show_password")} aria-label=${t("page.show_password")}
      aria-pressed=${shown ? "true" : "false"} aria-controls=${id} onClick=${() => setShown(!shown)} /></div>
    <${FieldNote} id=${note} help=${help} wrong=${wrong} /></div>`;
}

/** End of a form in a dialog: the error of its request, the button that closes the dialog, and the one that sends. */
export const FormEnd = ({ error, onClose, submit, ...rest }) => html`<${ErrorNote} error=${error} /><div class="row end">
  <${Button} onClick=${onClose}>${t("page.cancel")}<//><button type="submit" class="button main" ...${rest}>${submit}</button></div>`;

/** The list without an item that it has, else with it. */
export const toggled = (list, item) => (list.includes(item) ? list.filter((other) => other !== item) : [...list, item]);

/** Buttons of which one is chosen: `options` is [[value, text], …]. */
export function Choice({ label, value, options, onChange, disabled = false }) {
  return html`<div class="choice" role="group" aria-label=${label}>${options.map(([name, text]) => html`
    <button type="button" key=${name} aria-pressed=${name === value ? "true" : "false"} disabled=${disabled}
      onClick=${() => onChange(name)}>${text}</button>`)}</div>`;
}

/** A text in which no line ends within a number such as that of motor 3-12, or within a date. */
export const withWholeNumbers = (text) => text.split(/(\d+(?:-\d+)+)/).map((part, n) => (n % 2 === 0 ? part
  : html`<span class="whole-number">${part}</span>`));

/** A text with its commands as code: in the catalogue they stand between backticks. */
export const withCommands = (text) => text.split("`").map((part, n) => (n % 2 === 0 ? withWholeNumbers(part)
  : html`<code>${part}</code>`));

/** kind: "info", "good", "warning", "bad". */
export function Notice({ kind = "info", title, live = false, children }) {
  const icon = { warning: "warning", bad: "fault", good: "check" }[kind];
  return html`<div class=${`notice ${kind}`} role=${live ? "alert" : undefined}>
    ${icon && html`<${Icon} name=${icon} />`}<div>${title && html`<strong>${title}</strong>`}${children}</div></div>`;
}

/** Text of an ApiError, with the frames of its outcome. */
export function ErrorNote({ error }) {
  if (!error) return null;
  if (error.outcome) return html`<${OutcomeNote} outcome=${error.outcome} />`;
  return html`<${Notice} kind="bad" live>${withCommands(error.sentence ?? String(error))}<//>`;
}

const OUTCOME_KIND = { confirmed: "good", acknowledged: "info", refused: "bad", failed: "bad", unknown: "bad" };

/** Outcome of a command: status, sentence, notes, and the frames on demand. */
export function OutcomeNote({ outcome }) {
  if (!outcome) return null;
  return html`<${Notice} kind=${OUTCOME_KIND[outcome.status] ?? "info"} live title=${t(`page.outcome_${outcome.status}`)}>
    <p>${withCommands(localized(outcome.text))}</p>
    ${outcome.notes?.map((note) => localized(note.text)).filter((text) => text !== localized(outcome.text))
      .map((text, n) => html`<p key=${n}>${text}</p>`)}
    ${outcome.frames?.length > 0 && html`<details class="frames"><summary>${t("page.frames")}</summary>
      <${Frames} frames=${outcome.frames} /></details>`}<//>`;
}

function Frames({ frames }) {
  return html`<table class="data"><thead><tr><th>${t("page.frame_sent")}</th><th>${t("page.frame_received")}</th></tr>
    </thead><tbody>${frames.map((frame, n) => html`<tr key=${n}><td class="mono">${frame.sent}</td>
    <td class="mono">${frame.received || (frame.error && t(frame.error, frame.params)) || NO_VALUE}</td></tr>`)}</tbody></table>`;
}

/** Mark of a value that is not good, with the reason as text for screen readers. */
function QualityNote({ found, why }) {
  const isOld = found.quality === "bad" && found.age_s !== null;
  const word = isOld ? t("page.old", { age: duration(found.age_s) }) : t(`page.quality_${found.quality}`);
  return html`<span class="doubt"><${Icon} name="unknown" size=${14} />${word}<span class="sr">${why}</span></span>`;
}

/** A number with its unit, marked where its quality is not good. `found` comes from `reading`; `brief` leaves
 * the reason to the title. */
export function Value({ found, big = false, brief = false, digits }) {
  const style = big ? "big" : "";
  if (!found || found.value === null) {
    const why = found?.reason ? t(found.reason) : t("page.no_value");
    return html`<span class=${`value none ${style}`} title=${why}><span class="number">${NO_VALUE}</span>
      <span class=${big && !brief ? "unit" : "sr"}>${why}</span></span>`;
  }
  const isGood = found.quality === "good";
  const reason = found.reason ? t("page.colon") + t(found.reason) : "";
  const why = isGood ? undefined : t(`page.quality_${found.quality}`) + reason;
  return html`<span class=${`value ${found.quality} ${style}`} title=${why}>
    <span class="number">${number(found.value, found.unit, digits)}</span><span class="unit">${found.unit}</span>
    ${!isGood && html`<${QualityNote} found=${found} why=${why} />`}</span>`;
}

/** What the keyboard reaches while a window is open, beside the window itself. */
const BESIDE_DIALOG = "dialog, .stopbar, .notices";

/** Field of the form that stands above a window while every command of an idle session is refused. */
const UNLOCK_PASSWORD = "[data-do=unlock] .password input";

/** A window over the page; Escape closes it, and a press beside it does until something was typed or chosen in it. It is not
 * modal: after its last field comes the stop bar, then the password of an idle session, then the window again. */
export function Dialog({ title, onClose, children, class: more = "" }) {
  const box = useRef(null);
  const hasInput = useRef(false);
  const id = useId();
  useLayoutEffect(() => {
    const before = document.activeElement;
    const dialog = box.current;
    dialog.show();
    (dialog.querySelector("[data-first]") ?? dialog).focus();
    const keepOut = ({ target, relatedTarget }) => {
      if (target.closest(BESIDE_DIALOG)) return;
      const next = dialog.contains(relatedTarget) ? ".stopbar button" : relatedTarget === null ? UNLOCK_PASSWORD : null;
      ((next && document.querySelector(next)) ?? dialog).focus();
    };
    document.addEventListener("focusin", keepOut);
    return () => {
      document.removeEventListener("focusin", keepOut);
      const { activeElement } = document;
      // A stop that has the focus keeps it: an answer may close the window between its key and Enter.
      if (dialog.contains(activeElement) || activeElement === document.body) before?.focus?.();
    };
  }, []);
  // On the document: a button that has been disabled under the finger has lost the focus. Before the paint: a key that
  // follows the first sight of the window closes it.
  useLayoutEffect(() => {
    const key = (event) => { if (event.key === "Escape" && !isComposing(event)) onClose(); };
    document.addEventListener("keydown", key);
    return () => document.removeEventListener("keydown", key);
  });
  return html`<div class="veil" onClick=${() => { if (!hasInput.current) onClose(); }}></div>
    <dialog ref=${box} class=${`dialog ${more}`} aria-labelledby=${id} tabindex="-1" onInput=${() => { hasInput.current = true; }}
      onClick=${({ target }) => { if (target.closest(".choice")) hasInput.current = true; }}>
      <header><h2 id=${id}>${title}</h2>
        <${Button} kind="quiet" icon="close" onClick=${onClose} aria-label=${t("page.close")} /></header>
      ${children}</dialog>`;
}

/** A table that scrolls within itself where the screen is narrow; there the cells of one that `stacks` are below each other,
 * with the first one and the buttons above. `columns`: [[title, row → cell, class]…]. */
export function Table({ caption, columns, rows, keyOf, empty, rowClass, stacks = false }) {
  return html`<div class=${stacks ? "scroll stacks" : "scroll"} tabindex="0" role="region" aria-label=${caption}><table class="data">
    <caption class="sr">${caption}</caption>
    <thead><tr>${columns.map(([title, , style]) => html`<th key=${title} class=${style} scope="col">${title}</th>`)}
    </tr></thead><tbody>${rows.map((row) => html`<tr key=${keyOf(row)} class=${rowClass?.(row)}>${columns.map(
      ([title, cell, style]) => html`<td key=${title} class=${style} data-title=${title}>${cell(row)}</td>`)}</tr>`)}
    ${rows.length === 0 && html`<tr><td class="empty" colspan=${columns.length}>${empty ?? t("page.nothing")}</td>
    </tr>`}</tbody></table></div>`;
}

/** Execute one request at a time for a part of the page: `[execute, busy, error, result, clear]`. */
export function useRequest() {
  const [state, setState] = useState({ busy: false, error: null, result: null });
  const alive = useRef(true);
  useEffect(() => () => { alive.current = false; }, []);
  const set = (next) => { if (alive.current) setState(next); };
  const execute = async (request) => {
    set({ busy: true, error: null, result: null });
    try {
      const result = await request();
      set({ busy: false, error: null, result });
      return result;
    } catch (error) {
      set({ busy: false, error, result: null });
      return null;
    }
  };
  return [execute, state.busy, state.error, state.result, () => set({ busy: false, error: null, result: null })];
}

/** Load now and again whenever one of `inputs` changes: `[value, error, reload]`. */
export function useLoaded(load, inputs) {
  const [state, setState] = useState({ value: null, error: null });
  const [round, setRound] = useState(0);
  useEffect(() => {
    let current = true;
    load().then(
      (value) => current && setState({ value, error: null }),
      (error) => current && setState((old) => ({ value: old.value, error })),
    );
    return () => { current = false; };
  }, [...inputs, round]);
  const again = () => setRound((n) => n + 1);
  useReloadOnReconnect(state.error, again);
  return [state.value, state.error, again];
}

/** Call `again` after a reconnect where the last request got no answer. */
export function useReloadOnReconnect(error, again) {
  useEffect(() => { if (isLive.peek() && error?.unreachable) again(); }, [isLive.value]);
}

export const Loading = () => html`<p class="loading" role="status">${t("page.loading")}</p>`;
