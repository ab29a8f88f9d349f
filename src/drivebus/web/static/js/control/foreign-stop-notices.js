// Notices on every page: stops of drives of this session by other users.
import { html } from "../lib.js";
import { t } from "../i18n.js";
import { clock } from "../format.js";
import { Icon } from "../icons.js";
import { href } from "../router.js";
import { listDrives } from "../titles.js";
import { Button } from "../ui.js";
import { dismissStops, groupedStops } from "./foreign-stops.js";

/** The live region exists before its text, so that screen readers announce it. */
export function ForeignStopNotices() {
  return html`<div class="takeovers" role="status">${groupedStops().map((alike) => {
    const [{ stop }] = alike;
    const ids = alike.map((item) => item.drive);
    const params = { actor: stop.actor, name: listDrives(ids), time: clock(alike.at(-1).stop.time_ms) };
    return html`<div class="banner high" key=${`${stop.actor} ${stop.kind}`} data-stopped-by=${stop.kind}><${Icon} name="stop" />
      <a href=${ids.length > 1 ? href("fleet") : href("drive", ids[0])}>${t(`page.foreign_stop_${stop.kind}`, params)}</a>
      <${Button} onClick=${() => dismissStops(alike)} data-do="read">${t("page.taken_read")}<//></div>`;
  })}</div>`;
}
