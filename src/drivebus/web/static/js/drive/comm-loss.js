// Behaviour of a drive at a communication loss: its badge, its test and its waiver.
import { html, useState } from "../lib.js";
import { localized, t, titleOf } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { Icon } from "../icons.js";
import { Button, Dialog, ErrorNote, FormEnd, Notice, useRequest } from "../ui.js";
import { may } from "../session.js";
import { isLive } from "../live.js";
import { ReasonField } from "../control/reason-field.js";
import { CommLossTest } from "./comm-loss-test.js";

function WaiverForm({ view, onClose }) {
  const [reason, setReason] = useState("");
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    if (await execute(() => api.post(drivePath(view.id, "/waiver"), { reason: reason.trim() }))) onClose();
  };
  return html`<${Dialog} title=${t("page.waiver")} onClose=${onClose}><form class="stack" onSubmit=${send}>
    <p>${t("page.waiver_ask", { name: titleOf(view) })}</p>
    <${ReasonField} label=${t("page.waiver_reason")} value=${reason} onChange=${setReason} required data-first />
    <${FormEnd} error=${error} onClose=${onClose} submit=${t("page.waiver_record")} disabled=${busy} /></form><//>`;
}

/** Badge: what the drive does at a communication loss. */
export function CommLossBadge({ badge }) {
  const calm = badge.kind === "trips";
  const kind = badge.tested?.holds ? `tested_${badge.tested.result}` : badge.kind;
  const words = t(`page.comm_loss_${kind}`, { after: badge.after_s ?? "?" });
  return html`<span class=${`badge ${calm ? "calm" : "warn"}`}><${Icon} name=${calm ? "check" : "warning"} size=${16} />
    <span>${words}${badge.waiver && ` · ${t("page.waived")}`}</span></span>`;
}

/** Communication-loss behaviour as text, with its test and the waiver. */
export function CommLoss({ view }) {
  const [asking, setAsking] = useState(false);
  const [execute, busy, error] = useRequest();
  const badge = view.comm_loss;
  const needs = badge.kind !== "trips";
  return html`<div class="stack"><div><${CommLossBadge} badge=${badge} /></div><p class="soft">
    ${localized(badge.text)}</p><${CommLossTest} view=${view} />
    ${badge.waiver && html`<${Notice} title=${t("page.waiver")}>${badge.waiver}
      ${may("limit") && html`<div><${Button} kind="quiet" busy=${busy}
        onClick=${() => execute(() => api.remove(drivePath(view.id, "/waiver")))}>
        ${t("page.waiver_withdraw")}<//></div>`}<//>`}
    ${needs && !badge.waiver && may("limit") && html`<div><${Button} disabled=${!isLive.value}
      onClick=${() => setAsking(true)} data-do="waive">${t("page.waiver_record")}…<//></div>`}
    <${ErrorNote} error=${error} />${asking && html`<${WaiverForm} view=${view} onClose=${() => setAsking(false)} />`}
      </div>`;
}
