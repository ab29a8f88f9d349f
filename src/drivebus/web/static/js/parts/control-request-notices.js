// Notices on every page: another user asks for control of a drive of this session; the answer to an own request.
import { html } from "../lib.js";
import { t, titleOf } from "../i18n.js";
import { declineRequest, grantRequest, incomingRequests, markRead, secondsLeft, unreadAnswers } from "../control-requests.js";
import { Icon } from "../icons.js";
import { isLive, now } from "../live.js";
import { href } from "../router.js";
import { drive } from "../store.js";
import { Button, ErrorNote, useRequest } from "../ui.js";

const nameOf = (id) => titleOf(drive(id).value ?? { id });

function IncomingRequest({ id, request }) {
  const [run, busy, error] = useRequest();
  now.value; // counts down
  const off = busy || !isLive.value;
  const params = { user: request.user, name: nameOf(id), reason: request.reason };
  return html`<div class="banner medium" data-request=${id}><${Icon} name="warning" /><a href=${href("drive", id)}>
      ${t(request.reason ? "page.control_incoming_for" : "page.control_incoming", params)}</a>
    <span role="timer">${t("page.control_left", { s: secondsLeft(request) })}</span>
    <span class="row"><${Button} disabled=${off} onClick=${() => run(() => declineRequest(id, request))}
        data-do="decline">${t("page.control_decline")}<//>
      <${Button} kind="main" disabled=${off} onClick=${() => run(() => grantRequest(id, request))}
        data-do="hand-over">${t("page.control_hand_over")}<//></span>
    <${ErrorNote} error=${error} /></div>`;
}

function Answer({ id, request }) {
  const text = t(`page.control_answer_${request.state}`, { by: request.answered_by ?? "", name: nameOf(id) });
  return html`<div class=${`banner ${request.state === "granted" ? "info" : "medium"}`} data-answer=${request.state}>
    <a href=${href("drive", id)}>${text}</a>
    <${Button} onClick=${() => markRead(request)} data-do="read">${t("page.taken_read")}<//></div>`;
}

/** The live region exists before its text, so that screen readers announce it. */
export function ControlRequestNotices() {
  return html`<div class="takeovers" role="status">
    ${incomingRequests().map(({ id, request }) => html`<${IncomingRequest} key=${request.id} id=${id} request=${request} />`)}
    ${unreadAnswers().map(({ id, request }) => html`<${Answer} key=${request.id} id=${id} request=${request} />`)}</div>`;
}
