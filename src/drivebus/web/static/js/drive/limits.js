// Limits of a drive in force, of frequency and direction, and the form that narrows them.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api, drivePath } from "../api.js";
import { numberOf } from "../format.js";
import { isLive } from "../live.js";
import { may } from "../session.js";
import { highestHz } from "../control/frequency.js";
import { Button, Dialog, Field, FormEnd, useRequest } from "../ui.js";

/** Warning that the drive runs, or was set, above its limit, or nothing. A service that was not restarted since its upgrade
 * does not report it. */
function AboveLimit({ view: { above_limit_hz } }) {
  return Number.isFinite(above_limit_hz) && html`<b>${t("page.limits_above", { frequency_hz: above_limit_hz })}</b>`;
}

/** Limits in force; an engineer may narrow them. */
export function Limits({ view }) {
  const [open, setOpen] = useState(false);
  const [only, ...more] = view.directions;
  return html`<div class="row"><span>${t("page.limits_now", view)}${view.capabilities.includes("reverse")
    && more.length === 0 && t("page.limits_only", { way: t(`drives.direction_${only}`) })}</span>
    ${highestHz(view) < view.maximum_hz && html`<span data-text="capped">${t("page.limits_capped", { maximum_hz: highestHz(view) })}</span>`}
    <${AboveLimit} view=${view} />
    ${may("limit") && html`<${Button} kind="quiet" disabled=${!isLive.value} onClick=${() => setOpen(true)}>
      ${t("page.limits_change")}…<//>`}
    ${open && html`<${LimitsForm} view=${view} onClose=${() => setOpen(false)} />`}</div>`;
}

function LimitsForm({ view, onClose }) {
  const { minimum_hz, maximum_hz } = view;
  const has = (direction) => view.directions.includes(direction);
  const [values, setValues] = useState({
    minimum_hz: String(minimum_hz), maximum_hz: String(maximum_hz), forward: has("forward"), reverse: has("reverse"),
  });
  const [execute, busy, error] = useRequest();
  const put = (name, value) => setValues({ ...values, [name]: value });
  const limits = Object.fromEntries(["minimum_hz", "maximum_hz"].map((name) => [name, numberOf(values[name])]));
  const isWrong = Object.values(limits).includes(null) || !(values.forward || values.reverse);
  const send = async (event) => {
    event.preventDefault();
    if (await execute(() => api.put(drivePath(view.id, "/limits"), { ...values, ...limits }))) onClose();
  };
  const hertz = (name) => html`<${Field} key=${name} label=${t(`page.${name}`)}
    wrong=${limits[name] === null && t("page.not_number")}><span class="withunit">
    <input inputmode="decimal" autocomplete="off" maxlength="12" value=${values[name]}
      data-first=${name === "minimum_hz"} onInput=${(event) => put(name, event.currentTarget.value)} /><span>Hz</span>
    </span><//>`;
  const direction = (name) => html`<label class="check" key=${name}><input type="checkbox" checked=${values[name]}
    onChange=${(event) => put(name, event.currentTarget.checked)} />${t(`page.allow_${name}`)}</label>`;
  return html`<${Dialog} title=${t("page.limits_change")} onClose=${onClose}><form class="stack" onSubmit=${send}><p>
    ${t("page.limits_note")}</p>
    ${["minimum_hz", "maximum_hz"].map(hertz)}<div class="row">${["forward", "reverse"].map(direction)}</div>
    <${FormEnd} error=${error} onClose=${onClose} submit=${t("page.limits_set")} disabled=${busy || isWrong} /></form><//>`;
}
