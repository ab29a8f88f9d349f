// Notices on every page: another user asks for control of a drive of this session; the answer to an own request.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { declineRequests, grantRequests, incomingRequests, markRead, secondsLeft, unreadAnswers } from "./requests.js";
import { Icon } from "../icons.js";
import { isLive } from "../live.js";
import { href } from "../router.js";
import { Button, ErrorNote, useRequest } from "../ui.js";
import { listDrives } from "../titles.js";

/** The drive of a notice, or the fleet where it is about several. */
const hrefOf = (ids) => (ids.length > 1 ? href("fleet") : href("drive", ids[0]));

function IncomingRequest({ ids, request }) {
  const [execute, busy, error] = useRequest();
  const off = busy || !isLive.value;
  const params = { user: request.user, name: listDrives(ids), reason: request.reason };
  return html`<div class="banner medium" data-request=${ids[0]}><${Icon} name="warning" /><a href=${hrefOf(ids)}>
      ${t(request.reason ? "page.control_incoming_for" : "page.control_incoming", params)}</a>
    <span role="timer">${t("page.control_left", { s: secondsLeft(request) })}</span>
    <span class="row"><${Button} disabled=${off} onClick=${() => execute(() => declineRequests(ids, request))}
        data-do="decline">${t("page.control_decline")}<//>
      <${Button} kind="main" disabled=${off} onClick=${() => execute(() => grantRequests(ids, request))}
        data-do="hand-over">${t("page.control_hand_over")}<//></span>
    <${ErrorNote} error=${error} /></div>`;
}

function Answer({ ids, request }) {
  const text = t(`page.control_answer_${request.state}`, { by: request.answered_by ?? "", name: listDrives(ids) });
  return html`<div class=${`banner ${request.state === "granted" ? "info" : "medium"}`} data-answer=${request.state}>
    <a href=${hrefOf(ids)}>${text}</a>
    <${Button} onClick=${() => markRead(request)} data-do="read">${t("page.taken_read")}<//></div>`;
}

/** The live region exists before its text, so that screen readers announce it. */
export function ControlRequestNotices() {
  return html`<div class="takeovers" role="status">
    ${incomingRequests().map(({ ids, request }) => html`<${IncomingRequest} key=${request.id} ids=${ids} request=${request} />`)}
    ${unreadAnswers().map(({ ids, request }) => html`<${Answer} key=${`${request.id} ${ids[0]}`} ids=${ids} request=${request} />`)}</div>`;
}
