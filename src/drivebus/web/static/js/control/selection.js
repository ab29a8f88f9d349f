// A command to selected drives: its dialog, its results, and a button for each such command.
import { html, useState } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { api } from "../api.js";
import { moveFocusAmong } from "../arrow-keys.js";
import { isLive } from "../live.js";
import { isInOtherWindow, isMine } from "../session.js";
import { listDrives } from "../titles.js";
import { Button, Dialog, ErrorNote, Notice, toggled, useRequest } from "../ui.js";
import { mergeSentences } from "./merge-sentences.js";
import { ReasonField } from "./reason-field.js";
import { openRequest } from "./requests.js";

/** A longer list has buttons that choose all or none. */
const MAX_DRIVES_WITHOUT_CHOOSE_ALL = 3;

/** Result of each drive of {id: {status} or an error}: the refusals merged, and the drives that were done. */
function SelectionResults({ outcomes }) {
  const entries = Object.entries(outcomes);
  const done = entries.filter(([, outcome]) => outcome.status === "done").map(([id]) => id);
  const refused = mergeSentences(entries.filter(([, outcome]) => outcome.code).map(([id, outcome]) => ({ ...outcome, id, key: outcome.code })));
  return html`<${Notice} live kind=${refused.length ? "warning" : undefined}><ul>
    ${done.length > 0 && html`<li>${t("page.selection_done", { names: listDrives(done) })}</li>`}
    ${refused.map((merged) => html`<li key=${merged.ids[0]}>${merged.text}</li>`)}
    ${done.length + refused.length === 0 && html`<li>${t("page.selection_unchanged")}</li>`}</ul><//>`;
}

const moveFocus = moveFocusAmong("input");

/** Check boxes of drives as one stop of the Tab key, so that the way to the buttons is as short with 300 of them. Enter sends
 * nothing: a check box is no button. */
function DriveChoices({ views, left, onChange }) {
  const [reached, setReached] = useState(views[0].id);
  const key = (event) => {
    if (event.key === "Enter") event.preventDefault();
    moveFocus(event);
  };
  return html`<div class="choices" role="group" aria-describedby="choices-keys" onKeyDown=${key}>${views.map((view) => html`
    <label class="check" key=${view.id}><input type="checkbox" checked=${!left.includes(view.id)}
      tabindex=${view.id === reached ? 0 : -1}
      onFocus=${() => setReached(view.id)} onChange=${() => onChange(toggled(left, view.id))} />${titleOf(view)}</label>`)}</div>
    ${views.length > 1 && html`<p class="hint for-keys" id="choices-keys">${t("page.choose_keys")}</p>`}`;
}

/** Dialog with the drives to choose from, all chosen at first; `reasonLabel` asks for a reason as well, which can stay empty
 * where it is `optional`. */
function SelectionDialog({ views, title, ask, path, act, reasonLabel, optional = false, onClose }) {
  const [offered] = useState(views); // a drive stays in the list where the request failed
  const [left, setLeft] = useState([]);
  const [reason, setReason] = useState("");
  const [execute, busy, error, result] = useRequest();
  const drives = offered.map((view) => view.id).filter((id) => !left.includes(id));
  const given = reason.trim();
  const send = (event) => {
    event.preventDefault();
    execute(() => api.post(path, { drives, ...(given ? { reason: given } : {}) }));
  };
  const off = busy || !isLive.value || drives.length === 0;
  return html`<${Dialog} title=${title} onClose=${onClose}><form class="stack" onSubmit=${send}><p>${ask}</p>
    ${!result && offered.length > MAX_DRIVES_WITHOUT_CHOOSE_ALL && html`<div class="row"><${Button} kind="quiet"
      onClick=${() => setLeft([])} data-do="choose-all">${t("page.choose_all")}<//><${Button} kind="quiet" data-do="choose-none"
      onClick=${() => setLeft(offered.map((view) => view.id))}>${t("page.choose_none")}<//></div>`}
    ${!result && html`<${DriveChoices} views=${offered} left=${left} onChange=${setLeft} />`}
    ${!result && reasonLabel && html`<${ReasonField} label=${reasonLabel} value=${reason} onChange=${setReason}
      required=${!optional} />`}
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

/** Request for control of those of these drives that another user controls and for which no request is open. */
export function AskForControlButton({ views }) {
  const others = views.filter((view) => view.lease && !isMine(view.lease) && !isInOtherWindow(view.lease)
    && !openRequest(view));
  return html`<${SelectionButton} views=${others} text="page.control_ask_all" title=${t("page.control_ask")}
    ask=${t("page.control_ask_all_how")} path="/control-requests" act=${t("page.control_ask_send")}
    reasonLabel=${t("page.control_ask_reason")} optional />`;
}
