// Owner of the control lease of a drive, with the buttons that change it: take, release, ask for control, take over.
import { html, useState } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { releaseControl, takeControl } from "../control/leases.js";
import { ReasonField, isLongEnough } from "../control/reason-field.js";
import { askForControl, openRequest, secondsLeft, withdrawRequest } from "../control/requests.js";
import { isLive } from "../live.js";
import { idle, isInOtherWindow, isMine, may } from "../session.js";
import { Button, Dialog, ErrorNote, FormEnd, useRequest } from "../ui.js";

function TakeOver({ view, onClose }) {
  const [execute, busy, error] = useRequest();
  const go = async () => { if (await execute(() => takeControl(view.id))) onClose(); };
  const owner = view.lease?.owner ?? "";
  const request = openRequest(view);
  return html`<${Dialog} title=${t("page.take_over")} onClose=${onClose}>
    <p>${isInOtherWindow(view.lease) ? t("page.take_over_ask_window", { name: titleOf(view) })
      : t("page.take_over_ask", { owner, name: titleOf(view) })}</p>
    ${request && !isMine(request) && html`<p><strong>${t("page.control_asked_other", { user: request.user })}</strong></p>`}
    <${ErrorNote} error=${error} />
    <div class="row end"><${Button} onClick=${onClose}>${t("page.cancel")}<//>
      <${Button} kind="main" busy=${busy} onClick=${go}>${t("page.take_over")}<//></div><//>`;
}

function AskForControl({ view, onClose }) {
  const [reason, setReason] = useState("");
  const [execute, busy, error] = useRequest();
  const given = reason.trim();
  const send = async (event) => {
    event.preventDefault();
    if (await execute(() => askForControl(view.id, given))) onClose();
  };
  return html`<${Dialog} title=${t("page.control_ask_title", { name: titleOf(view) })} onClose=${onClose}>
    <p>${t("page.control_ask_how", { owner: view.lease?.owner ?? "" })}</p>
    <form class="stack" onSubmit=${send}>
      <${ReasonField} label=${t("page.control_ask_reason")} value=${reason} onChange=${setReason} data-first />
      <${FormEnd} error=${error} onClose=${onClose} submit=${t("page.control_ask_send")} data-do="send-request"
        disabled=${busy || (given !== "" && !isLongEnough(given))} /></form><//>`;
}

/** State of the open request for control: of this session with the seconds left, or of another user. */
function OpenRequest({ view, request }) {
  const [execute, busy, error] = useRequest();
  if (!isMine(request)) return html`<span class="soft">${t("page.control_asked_other", { user: request.user })}</span>`;
  return html`<span role="timer">${t("page.control_asked_own", { s: secondsLeft(request) })}</span>
    <${Button} busy=${busy} onClick=${() => execute(() => withdrawRequest(view.id))} data-do="withdraw">
      ${t("page.control_withdraw")}<//><${ErrorNote} error=${error} />`;
}

function holderText(view) {
  if (!view.lease) return t("page.lease_free");
  if (isMine(view.lease)) return t("page.lease_mine");
  return isInOtherWindow(view.lease) ? t("page.lease_other_window") : t("page.lease_other", { owner: view.lease.owner });
}

export function ControlLease({ view }) {
  const [execute, busy, error] = useRequest();
  const [dialog, setDialog] = useState(null);
  const close = () => setDialog(null);
  const mine = isMine(view.lease);
  const others = view.lease && !mine;
  const can = isLive.value && may("operate");
  const request = openRequest(view);
  // A lease lasts ten seconds: without a connection its owner is unknown.
  return html`<div class=${`lease ${mine && isLive.value ? "own" : ""}`}><span class="holder" role="status">${holderText(view)}
    ${!isLive.value && html` <span class="outdated">${t("page.state_was")}</span>`}</span>
    ${!view.lease && (may("operate") || idle.value) && html`<${Button} kind="main" disabled=${!can} busy=${busy}
      onClick=${() => execute(() => takeControl(view.id))} data-do="take">${t("page.lease_take")}<//>`}
    ${mine && html`<${Button} busy=${busy} onClick=${() => execute(() => releaseControl(view.id))}
      title=${t("page.lease_every_tab")}>${t("page.lease_give")}<//>`}
    ${others && request && html`<${OpenRequest} view=${view} request=${request} />`}
    ${others && !request && !isInOtherWindow(view.lease) && may("operate") && html`<${Button} disabled=${!can} onClick=${() => setDialog("ask")}
      data-do="ask">${t("page.control_ask")}…<//>`}
    ${others && may("write_parameters") && html`<${Button} disabled=${!can} onClick=${() => setDialog("take")}>
      ${t("page.take_over")}…<//>`}
    <${ErrorNote} error=${error} />${dialog === "take" && html`<${TakeOver} view=${view} onClose=${close} />`}
    ${dialog === "ask" && html`<${AskForControl} view=${view} onClose=${close} />`}</div>`;
}
