// Login page; at the first start the set-up, with the secret that the service printed on its own machine.
import { html, useEffect, useRef, useState } from "../lib.js";
import { localized, t } from "../i18n.js";
import { ErrorNote, Field, Notice, PasswordField, useRequest } from "../ui.js";
import { endText, hasEnded, login, session, setUp } from "../session.js";
import { StopResult } from "../control/stop-bar.js";
import { openStops } from "../control/stops.js";
import { PreferenceButtons } from "../preference-buttons.js";
import { MIN_PASSWORD_LENGTH, passwordHelp } from "../settings/password.js";

/** `fields`: [name, autocomplete] of those above the password. */
function Form({ title, note, fields, isNew, submit, send }) {
  const [values, setValues] = useState({});
  const [execute, busy, error] = useRequest();
  const form = useRef(null);
  useEffect(() => { form.current.querySelector("input").focus(); }, []);
  const put = (name) => (event) => setValues({ ...values, [name]: event.currentTarget.value });
  const go = (event) => { event.preventDefault(); execute(() => send(values)); };
  return html`<form ref=${form} class="login" onSubmit=${go}><h1>${title}</h1>${note}
    ${fields.map(([name, complete]) => html`<${Field} key=${name} label=${t(`page.login_${name}`)}>
      <input name=${name} type="text" autocomplete=${complete} required value=${values[name] ?? ""}
        onInput=${put(name)} spellcheck=${false} autocapitalize="none" /><//>`)}
    <${PasswordField} name="password" label=${t("page.login_password")} required value=${values.password ?? ""}
      autocomplete=${isNew ? "new-password" : "current-password"} help=${isNew && passwordHelp()}
      minlength=${isNew ? MIN_PASSWORD_LENGTH : undefined} onInput=${put("password")} />
    <${ErrorNote} error=${error} /><button type="submit" class="button main" disabled=${busy}>${submit}</button>
      </form>`;
}

/** Configured text of the login page. */
function LoginNotice() {
  const text = session.value.login_notice;
  return text ? html`<${Notice}><span data-text="login-notice">${localized(text)}</span><//>` : null;
}

const LoginForm = () => html`<${Form} title=${t("page.log_in")} submit=${t("page.log_in")} note=${html`<${LoginNotice} />`}
  fields=${[["name", "username"]]} send=${({ name, password }) => login(name, password)} />`;

const SetUpForm = () => html`<${Form} title=${t("page.set_up")} submit=${t("page.set_up_do")}
  note=${html`<${Notice}>${t("page.set_up_how")}<//>`}
  fields=${[["secret", "off"], ["name", "username"]]} isNew
  send=${({ secret, name, password }) => setUp(secret.trim(), name, password)} />`;

/** The users' file of this plant is gone: no login and no set-up is possible. */
const UsersMissing = () => html`<div class="login"><h1>${t("page.log_in")}</h1>
  <${Notice} kind="bad"><span data-text="users-missing">${localized(session.value.users_missing)}</span><//></div>`;

/** `error`: the error of a login code in the address. */
export function Login({ error }) {
  return html`<main class="loginpage"><p class="brand">drivebus</p><${ErrorNote} error=${error} />
    ${hasEnded.value && html`<${Notice} kind="warning" live><span data-text="session-ended">${endText.value ? localized(endText.value) : t("page.session_ended")}${t("language.between_sentences")}${t("page.session_ended_stops")}</span><//>
      ${openStops().map((entry) => html`<${StopResult} key=${entry.id} entry=${entry} />`)}`}
    ${session.value.users_missing ? html`<${UsersMissing} />`
      : session.value.setup ? html`<${SetUpForm} />` : html`<${LoginForm} />`}
    <div class="prefs"><${PreferenceButtons} /></div></main>`;
}
