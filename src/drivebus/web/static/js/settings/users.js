// Users and their roles, for administrators. The server rejects a change of one's own role and the removal of the last
// administrator.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { session } from "../session.js";
import { Button, Dialog, ErrorNote, Field, FormEnd, Loading, PasswordField, Table, useLoaded, useRequest } from "../ui.js";
import { passwordHelp } from "./password.js";

const ROLES = ["viewer", "operator", "engineer", "administrator"];
const pathOf = (user) => `/users/${encodeURIComponent(user.name)}`;

export function Users() {
  const [found, error, reload] = useLoaded(() => api.get("/users"), []);
  const [open, setOpen] = useState(null);
  if (!found) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  const close = () => { setOpen(null); reload(); };
  const columns = [
    [t("page.name"), (user) => html`<strong>${user.name}</strong>${user.name === session.value.user
      ? ` ${t("page.you")}` : ""}`, "name"],
    [t("page.role"), (user) => t(`page.role_${user.role}`)],
    [t("page.state"), (user) => t(user.disabled ? "page.user_disabled" : "page.user_enabled")],
    [t("page.sessions"), (user) => user.sessions, "right"],
    [t("page.tokens"), (user) => user.tokens, "right"],
    [t("page.created"), (user) => moment(user.created_ms), "time"],
    [t("page.change"), (user) => html`<${Button} onClick=${() => setOpen(user)}
      aria-label=${t("page.change_user", { name: user.name })}>${t("page.change")}<//>`, "act"],
  ];
  return html`<section class="panel stack"><div class="row between"><h2>${t("page.users")}</h2>
      <${Button} kind="main" onClick=${() => setOpen("new")}>${t("page.add_user")}<//></div>
    <${Table} stacks caption=${t("page.users")} columns=${columns} rows=${found.users} keyOf=${(user) => user.name} />
    ${open === "new" && html`<${NewUser} onClose=${close} />`}
    ${open && open !== "new" && html`<${ChangeUser} user=${open} onClose=${close} />`}</section>`;
}

const RoleChoice = ({ value, onChange, disabled }) => html`<${Field} label=${t("page.role")}
  help=${t(`page.role_${value}_may`)}>
  <select value=${value} disabled=${disabled} onChange=${(event) => onChange(event.target.value)}>
    ${ROLES.map((role) => html`<option key=${role} value=${role}>${t(`page.role_${role}`)}</option>`)}</select><//>`;

const OwnPassword = ({ value, onChange }) => html`<${PasswordField} label=${t("page.own_password")}
  autocomplete="current-password" value=${value} onInput=${(event) => onChange(event.target.value)} />`;

function NewUser({ onClose }) {
  const [given, setGiven] = useState({ name: "", role: "operator", password: "" });
  const [own, setOwn] = useState("");
  const sensitive = given.role === "administrator";
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    if (await execute(() => api.post("/users", sensitive ? { ...given, own_password: own } : given))) onClose();
  };
  return html`<${Dialog} title=${t("page.add_user")} onClose=${onClose}><form class="stack" onSubmit=${send}>
    <${Field} label=${t("page.name")}><input value=${given.name} autocomplete="off" maxlength="64" data-first
      onInput=${(event) => setGiven({ ...given, name: event.target.value })} /><//>
    <${RoleChoice} value=${given.role} onChange=${(role) => setGiven({ ...given, role })} />
    <${PasswordField} label=${t("page.first_password")} help=${passwordHelp() + t("language.between_sentences")
      + t("page.first_password_help")} autocomplete="new-password"
      value=${given.password} onInput=${(event) => setGiven({ ...given, password: event.target.value })} />
    ${sensitive && html`<${OwnPassword} value=${own} onChange=${setOwn} />`}
    <${FormEnd} error=${error} onClose=${onClose} submit=${t("page.add_user")}
      disabled=${busy || !given.name || !given.password || (sensitive && !own)} /></form><//>`;
}

function ChangeUser({ user, onClose }) {
  const [role, setRole] = useState(user.role);
  const [password, setPassword] = useState("");
  const [sure, setSure] = useState(false);
  const [execute, busy, error] = useRequest();
  const [own, setOwn] = useState("");
  const me = user.name === session.value.user;
  const sensitive = !me && role === "administrator";
  const change = async (body) => {
    const sent = own ? { ...body, own_password: own } : body;
    if (await execute(() => api.patch(pathOf(user), sent))) onClose();
  };
  const remove = async () => { if (await execute(() => api.remove(pathOf(user)))) onClose(); };
  return html`<${Dialog} title=${t("page.change_user", { name: user.name })} onClose=${onClose}><div class="stack">
    <${RoleChoice} value=${role} onChange=${setRole} disabled=${me} />
    ${sensitive && html`<${OwnPassword} value=${own} onChange=${setOwn} />`}
    ${me && html`<p class="help">${t("page.not_oneself")}</p>`}
    <div class="row"><${Button} kind="main" busy=${busy} disabled=${role === user.role}
      onClick=${() => change({ role })}>${t("page.save_role")}<//>
      ${!me && html`<${Button} busy=${busy} onClick=${() => change({ disabled: !user.disabled })}>
        ${t(user.disabled ? "page.enable_user" : "page.disable_user")}<//>`}
      <${Button} busy=${busy} disabled=${user.sessions === 0}
        onClick=${() => change({ end_sessions: true })}>${t("page.end_sessions")}<//></div>
    ${!me && html`<${PasswordField} label=${t("page.password_new")} help=${passwordHelp()}
      autocomplete="new-password" value=${password} onInput=${(event) => setPassword(event.target.value)} />
      <div class="row"><${Button} busy=${busy} disabled=${!password}
        onClick=${() => change({ password })}>${t("page.set_password")}<//></div>
      <label class="check"><input type="checkbox" checked=${sure}
        onChange=${(event) => setSure(event.target.checked)} />${t("page.remove_user_sure")}</label>
      <div class="row"><${Button} kind="danger" busy=${busy} disabled=${!sure}
        onClick=${remove}>${t("page.remove_user")}<//></div>`}
    <${ErrorNote} error=${error} /></div><//>`;
}
