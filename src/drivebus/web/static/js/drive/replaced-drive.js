// Notice that a reload of the configuration has put another motor behind the page of a drive.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { Icon } from "../icons.js";
import { route } from "../router.js";
import { drive } from "../store.js";
import { busTitle } from "../titles.js";
import { Button } from "../ui.js";

/** What tells a motor from another one with the same id. */
export const motorOf = ({ bus, address, model }) => `${bus} ${address} ${model}`;

function Replaced({ view }) {
  const [before, setBefore] = useState(view);
  if (motorOf(view) === motorOf(before)) return null;
  const place = { bus: busTitle(before.bus), address: before.address, model: before.model };
  return html`<div class="banner high" data-text="replaced"><${Icon} name="warning" /><span>${t("page.drive_replaced", place)}</span>
    <${Button} onClick=${() => setBefore(view)}>${t("page.close")}<//></div>`;
}

/** The notice, for the drive of the address; nothing while its motor is the one of when the page was opened. */
export function ReplacedDrive() {
  const { page, id } = route.value;
  const view = page === "drive" ? drive(id).value : null;
  return html`<div role="status">${view && html`<${Replaced} key=${id} view=${view} />`}</div>`;
}
