// Notices on every page: control of drives that this session has lost.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { clock } from "../format.js";
import { Icon } from "../icons.js";
import { href } from "../router.js";
import { listDrives } from "../titles.js";
import { Button } from "../ui.js";
import { dismiss, groupTakeovers, takeovers } from "./takeovers.js";

function takeoverKey({ cause, time_ms }) {
  if (cause === "tab" || cause === "ended") return time_ms === null ? "page.control_ended_unseen" : `page.control_ended_${cause}`;
  if (cause === "window") return time_ms === null ? "page.taken_window_unseen" : "page.taken_window";
  return time_ms === null ? "page.taken_unseen" : "page.taken";
}

/** Takeovers of drives, those of one kind by one user in one sentence with the time of the last. The live region exists
 * before its text, so that screen readers announce it. */
export function TakeoverNotices() {
  return html`<div class="takeovers" role="status">${groupTakeovers(takeovers.value).map((equal) => {
    const [takeover] = equal;
    const ids = [...new Set(equal.map((other) => other.drive))];
    const params = { owner: takeover.owner, name: listDrives(ids), time: clock(equal.at(-1).time_ms) };
    return html`<div class="banner high" key=${`${takeover.drive} ${takeover.time_ms}`}><${Icon} name="warning" />
      <a href=${ids.length > 1 ? href("fleet") : href("drive", takeover.drive)}>${t(takeoverKey(takeover), params)}</a>
      <${Button} onClick=${() => dismiss(equal)} data-do="read">${t("page.taken_read")}<//></div>`;
  })}</div>`;
}
