// Unlock form of an idle session, which can only view and stop; the password restores the other rights, leases stay.
import { html, useState } from "./lib.js";
import { localized, t } from "./i18n.js";
import { idle, session, unlock } from "./session.js";
import { ErrorNote, PasswordField, useRequest } from "./ui.js";

function Form() {
  const [password, setPassword] = useState("");
  const [execute, busy, error] = useRequest();
  const send = (event) => { event.preventDefault(); execute(() => unlock(password)); };
  return html`<form class="banner info" data-do="unlock" onSubmit=${send}>
    <span role="status">${t("page.idle")}</span>${session.value.login_notice
      && html`<span data-text="login-notice">${localized(session.value.login_notice)}</span>`}<input type="text" autocomplete="username" hidden readonly
      value=${session.value.user} />
    <${PasswordField} label=${t("page.login_password")} autocomplete="current-password" required
      value=${password} onInput=${(event) => setPassword(event.currentTarget.value)} />
    <${ErrorNote} error=${error} /><button class="button main" type="submit" disabled=${busy}>${t("page.unlock")}
      </button></form>`;
}

export const Unlock = () => (idle.value ? html`<${Form} />` : null);
