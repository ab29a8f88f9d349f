// API tokens of programs. A token's secret is shown once when it is added; the server stores only its hash.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { session } from "../session.js";
import { Button, Dialog, ErrorNote, Field, FormEnd, Loading, Notice, Table, toggled, useLoaded, useRequest } from "../ui.js";

const DAYS = [7, 30, 90, 365];

export function Tokens() {
  const [found, error, reload] = useLoaded(() => api.get("/tokens"), []);
  const [open, setOpen] = useState(false);
  const [made, setMade] = useState(null);
  if (!found) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  const close = (secret = null) => { setOpen(false); setMade(secret); reload(); };
  const columns = [
    [t("page.name"), (token) => html`<strong>${token.name}</strong>`, "name"],
    [t("page.user"), (token) => token.user],
    [t("page.rights"),
      (token) => token.rights.map((right) => t(`page.right_${right}`)).join(t("language.between_items"))],
    [t("page.expires"), (token) => moment(token.expires_ms), "time"],
    [t("page.remove"), (token) => html`<${Remove} token=${token} onDone=${() => close()} />`, "act"],
  ];
  return html`<section class="panel stack"><div class="row between"><h2>${t("page.tokens")}</h2>
      <${Button} kind="main" onClick=${() => setOpen(true)}>${t("page.add_token")}<//></div>
    <p class="help">${t("page.tokens_help")}</p>
    ${made && html`<${Notice} kind="good" live title=${t("page.token_made")}><code class="secret">${made}</code><//>`}
    <${Table} stacks caption=${t("page.tokens")} columns=${columns} rows=${found.tokens} keyOf=${(token) => token.id} />
    ${open && html`<${NewToken} onClose=${close} />`}</section>`;
}

function Remove({ token, onDone }) {
  const [execute, busy, error] = useRequest();
  const [sure, setSure] = useState(false);
  const remove = async () => { if (await execute(() => api.remove(`/tokens/${encodeURIComponent(token.id)}`))) onDone(); };
  return html`<${Button} kind=${sure ? "danger" : "plain"} busy=${busy} onClick=${() => (sure
    ? remove() : setSure(true))}
      onBlur=${() => setSure(false)} aria-label=${t("page.remove_token", { name: token.name })}>
    ${t(sure ? "page.remove_sure" : "page.remove")}<//><${ErrorNote} error=${error} />`;
}

function NewToken({ onClose }) {
  const [given, setGiven] = useState({ name: "", rights: ["view"], days: 90 });
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    const found = await execute(() => api.post("/tokens", given));
    if (found) onClose(found.secret);
  };
  return html`<${Dialog} title=${t("page.add_token")} onClose=${() => onClose()}><form class="stack" onSubmit=${send}>
    <${Field} label=${t("page.name")}><input value=${given.name} maxlength="64" autocomplete="off" data-first
      onInput=${(event) => setGiven({ ...given, name: event.target.value })} /><//>
    <fieldset class="checks"><legend>${t("page.rights")}</legend>${session.value.rights.map((right) => html`<label
      class="check" key=${right}>
      <input type="checkbox" checked=${given.rights.includes(right)}
        onChange=${() => setGiven({ ...given, rights: toggled(given.rights, right) })} />${t(`page.right_${right}`)}</label>`)}</fieldset>
    <${Field} label=${t("page.expires_after")}><select value=${given.days}
      onChange=${(event) => setGiven({ ...given, days: Number(event.target.value) })}>
      ${DAYS.map((days) => html`<option key=${days} value=${days}>${t("page.days", { n: days })}</option>`)}</select>
        <//>
    <${FormEnd} error=${error} onClose=${() => onClose()} submit=${t("page.add_token")}
      disabled=${busy || !given.name || given.rights.length === 0} /></form><//>`;
}
