// The user's own sessions. One of them is ended with the password.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { moment } from "../format.js";
import { loadSession } from "../session.js";
import { Button, Dialog, ErrorNote, FormEnd, Loading, PasswordField, Table, useLoaded, useRequest } from "../ui.js";

export function OwnSessions() {
  const [found, error, reload] = useLoaded(() => api.get("/sessions"), []);
  const [ending, setEnding] = useState(null);
  if (!found) return error ? html`<${ErrorNote} error=${error} />` : html`<${Loading} />`;
  const columns = [
    [t("page.network_address"), (session) => (session.current ? `${session.address} ${t("page.this_session")}` : session.address)],
    [t("page.logged_in_since"), (session) => moment(session.opened_ms), "time"],
    [t("page.last_active"), (session) => moment(session.active_ms), "time"],
    [t("page.end_session"), (session) => html`<${Button} onClick=${() => setEnding(session)}>${t("page.end_session")}<//>`,
      "act"],
  ];
  const close = async (ended) => {
    setEnding(null);
    if (ended?.current) await loadSession();
    else if (ended) reload();
  };
  return html`<section class="panel stack"><h2>${t("page.own_sessions")}</h2>
    <p class="help">${t("page.own_sessions_help")}</p>
    <${Table} stacks caption=${t("page.own_sessions")} columns=${columns} rows=${found.sessions} keyOf=${(session) => session.id} />
    ${ending && html`<${EndSession} ending=${ending} onClose=${close} />`}</section>`;
}

function EndSession({ ending, onClose }) {
  const [password, setPassword] = useState("");
  const [execute, busy, error] = useRequest();
  const send = async (event) => {
    event.preventDefault();
    if (await execute(() => api.post(`/sessions/${encodeURIComponent(ending.id)}/end`, { password }))) onClose(ending);
  };
  return html`<${Dialog} title=${t("page.end_session_title")} onClose=${() => onClose(null)}><form class="stack"
    onSubmit=${send}>
    <${PasswordField} label=${t("page.own_password")} help=${t("page.end_session_help")} data-first
      autocomplete="current-password" value=${password} onInput=${(event) => setPassword(event.target.value)} />
    <${FormEnd} error=${error} onClose=${() => onClose(null)} submit=${t("page.end_session")} disabled=${busy || !password} />
    </form><//>`;
}
