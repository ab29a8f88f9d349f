// Stop of a drive that has not answered as its model: sent by a person who has read the name plate.
import { html, useState } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { drive } from "../store.js";
import { stop } from "./stops.js";
import { Button, Dialog, Notice } from "../ui.js";

function Question({ view, how, onClose }) {
  const [hasRead, setHasRead] = useState(false);
  const params = { name: titleOf(view), model: view.model, address: view.address };
  const send = () => { stop("drive", view.id, how, { assume_model: true }); onClose(); };
  return html`<${Dialog} title=${t("page.stop_anyway_title", params)} onClose=${onClose}>
    <${Notice} kind="warning" title=${t("page.stop_anyway_may_start")}>${t("page.stop_anyway_why", params)}<//>
    <label class="check"><input type="checkbox" checked=${hasRead} onChange=${() => setHasRead(!hasRead)} />
      ${t("page.stop_anyway_read", params)}</label>
    <div class="row end"><${Button} onClick=${onClose}>${t("page.cancel")}<//>
      <${Button} kind="main" icon="stop" disabled=${!hasRead} onClick=${send} data-do="stop-anyway-send">${t("page.stop_anyway_send")}<//>
        </div><//>`;
}

/** Button that asks for the model on the name plate, and then sends the stop unread. */
export function StopAnyway({ id, how }) {
  const [open, setOpen] = useState(false);
  const view = drive(id).value;
  if (!view) return null;
  return html`<${Button} onClick=${() => setOpen(true)} data-do="stop-anyway">${t("page.stop_anyway", { name: titleOf(view) })}…<//>
    ${open && html`<${Question} view=${view} how=${how} onClose=${() => setOpen(false)} />`}`;
}
