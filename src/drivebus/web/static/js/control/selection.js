// A command to selected drives: its dialog, and results in which equal refusals are one sentence.
import { html, useState } from "../lib.js";
import { localized, replaced, t, titleOf } from "../i18n.js";
import { api } from "../api.js";
import { isLive } from "../live.js";
import { isMine } from "../session.js";
import { drive } from "../store.js";
import { Button, Dialog, ErrorNote, Field, Notice, useRequest } from "../ui.js";

const MIN_REASON_LENGTH = 3;
/** More drives have buttons that choose all or none. */
const FEW = 3;

export const nameOf = (id) => (drive(id).value ? titleOf(drive(id).value) : id);

/** Parameters of a sentence that name the drive. */
const OWN = ["drive", "station", "address"];
/** Measured values: of several drives the lowest and the highest are shown. All others must be equal for sentences to be one. */
const MEASURED = ["error_percent"];

/** Names of drives in one sentence; more are counted. */
const MAX_NAMES = 8;

/** Names of drives as a list; of many the first ones and the number of the others. */
export const listed = (ids) => shortList(ids, nameOf);

function shortList(items, text) {
  const names = items.slice(0, MAX_NAMES).map(text).join(t("language.between_items"));
  return items.length > MAX_NAMES ? t("page.names_more", { names, n: items.length - MAX_NAMES }) : names;
}

/** Equal sentences of several drives as one: `items` are {id, key, params, text}; the result is [{ids, text, isNamed}], and
 * `isNamed` says that the text has the names of the drives. */
export function mergeSentences(items) {
  const groups = new Map();
  for (const one of items) {
    const others = Object.entries(one.params ?? {}).filter(([name]) => ![...OWN, ...MEASURED].includes(name));
    const alike = JSON.stringify([one.key, others]);
    groups.set(alike, [...(groups.get(alike) ?? []), one]);
  }
  return [...groups.values()].map((alike) => ({ ids: alike.map(({ id }) => id), ...mergedText(alike) }));
}

function mergedText(alike) {
  const [{ params }] = alike;
  const text = MEASURED.reduce((sentence, name) => withRange(sentence, alike, name), localized(alike[0].text));
  const found = OWN.find((name) => params?.[name] !== undefined && text.includes(String(params[name])));
  if (!found) return { text, isNamed: false };
  const isNamed = found === "drive";
  const own = isNamed ? listed(alike.map(({ id }) => id)) : shortList(alike, (one) => one.params[found]);
  return { text: replaced(text, String(params[found]), own), isNamed };
}

/** The sentence of the first drive with the lowest and the highest of the measured values. */
function withRange(sentence, alike, name) {
  const values = alike.map(({ params }) => params?.[name]);
  const [least, most] = [Math.min(...values), Math.max(...values)].map(decimal);
  return least === most ? sentence : replaced(sentence, decimal(values[0]), t("page.value_range", { least, most }));
}

/** A measured value as the service writes it: "3.0", "3.12". */
const decimal = (value) => (Number.isInteger(value) ? value.toFixed(1) : String(value));

/** Result of each drive of {id: {status} or an error}: the refusals merged, and the drives that were done. */
function SelectionResults({ outcomes }) {
  const entries = Object.entries(outcomes);
  const done = entries.filter(([, one]) => one.status === "done").map(([id]) => id);
  const refused = mergeSentences(entries.filter(([, one]) => one.code).map(([id, one]) => ({ ...one, id, key: one.code })));
  return html`<${Notice} live kind=${refused.length ? "warning" : undefined}><ul>
    ${done.length > 0 && html`<li>${t("page.selection_done", { names: listed(done) })}</li>`}
    ${refused.map((one) => html`<li key=${one.ids[0]}>${one.text}</li>`)}
    ${done.length + refused.length === 0 && html`<li>${t("page.selection_unchanged")}</li>`}</ul><//>`;
}

/** Dialog with the drives to choose from, all chosen at first; `reasonLabel` asks for a reason as well, which can stay empty
 * where it is `optional`. */
function SelectionDialog({ views, title, ask, path, act, reasonLabel, optional = false, onClose }) {
  const [offered] = useState(views); // a drive stays in the list where the request failed
  const [left, setLeft] = useState([]);
  const [reason, setReason] = useState("");
  const [run, busy, error, result] = useRequest();
  const drives = offered.map((view) => view.id).filter((id) => !left.includes(id));
  const toggle = (id) => setLeft(left.includes(id) ? left.filter((one) => one !== id) : [...left, id]);
  const given = reason.trim();
  const send = (event) => {
    event.preventDefault();
    run(() => api.post(path, { drives, ...(given ? { reason: given } : {}) }));
  };
  const off = busy || !isLive.value || drives.length === 0;
  return html`<${Dialog} title=${title} onClose=${onClose}><form class="stack" onSubmit=${send}><p>${ask}</p>
    ${!result && offered.length > FEW && html`<div class="row"><${Button} kind="quiet" onClick=${() => setLeft([])}
      data-do="choose-all">${t("page.choose_all")}<//><${Button} kind="quiet" data-do="choose-none"
      onClick=${() => setLeft(offered.map((view) => view.id))}>${t("page.choose_none")}<//></div>`}
    ${!result && html`<div class="choices">${offered.map((view) => html`<label class="check" key=${view.id}><input type="checkbox"
      checked=${!left.includes(view.id)} onChange=${() => toggle(view.id)} />${titleOf(view)}</label>`)}</div>`}
    ${!result && reasonLabel && html`<${Field} label=${reasonLabel}><input value=${reason} maxlength="500" required=${!optional}
      minlength=${MIN_REASON_LENGTH} onInput=${(event) => setReason(event.currentTarget.value)} /><//>`}
    <${ErrorNote} error=${error} />${result?.outcomes && html`<${SelectionResults} outcomes=${result.outcomes} />`}
    <div class="row end"><${Button} onClick=${onClose}>${t(result ? "page.close" : "page.cancel")}<//>
      ${!result && html`<button type="submit" class="button main" disabled=${off} data-do="selection">${act}</button>`}
      </div></form><//>`;
}

/** Button that opens the dialog; null without drives. */
function SelectionButton({ views, text, ...rest }) {
  const [open, setOpen] = useState(false);
  if (views.length === 0 && !open) return null;
  return html`${views.length > 0 && html`<${Button} disabled=${!isLive.value} onClick=${() => setOpen(true)}
    data-select=${rest.path}>${t(text, { n: views.length })}…<//>`}${open && html`<${SelectionDialog} views=${views} ...${rest}
      onClose=${() => setOpen(false)} />`}`;
}

/** Release of those of these drives whose start a bus stop inhibits. */
export function ReleaseButton({ views }) {
  return html`<${SelectionButton} views=${views.filter((view) => view.start_inhibited)} text="page.release_all"
    title=${t("page.release")} ask=${t("page.release_ask")} path="/start-inhibits/release" act=${t("page.release")} />`;
}

/** Waivers of those of these drives that need one and have none. */
export function WaiverButton({ views }) {
  const needing = views.filter(({ comm_loss }) => comm_loss.kind !== "trips" && !comm_loss.waiver);
  return html`<${SelectionButton} views=${needing} text="page.waiver_record_all" title=${t("page.waiver")}
    reasonLabel=${t("page.waiver_reason")}
    ask=${t("page.waiver_ask_all")} path="/waivers" act=${t("page.waiver_record")} />`;
}

/** Request for control of those of these drives that another session controls and for which no request is open. */
export function AskForControlButton({ views }) {
  const others = views.filter(({ lease, control_request }) => lease && !isMine(lease) && control_request?.state !== "open");
  return html`<${SelectionButton} views=${others} text="page.control_ask_all" title=${t("page.control_ask")}
    ask=${t("page.control_ask_all_how")} path="/control-requests" act=${t("page.control_ask_send")}
    reasonLabel=${t("page.control_ask_reason")} optional />`;
}
