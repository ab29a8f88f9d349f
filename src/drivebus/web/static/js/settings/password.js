// The user's own password. Changing it ends every other session of the user.
import { html, useState } from "../lib.js";
import { t } from "../i18n.js";
import { api } from "../api.js";
import { session } from "../session.js";
import { ErrorNote, Notice, PasswordField, useRequest } from "../ui.js";

export const MIN_PASSWORD_LENGTH = 10;

/** Rules for a password, shown before one is chosen. */
export const passwordHelp = () => t("page.password_help", { n: MIN_PASSWORD_LENGTH });

const EMPTY = { old: "", new: "", again: "" };

export function Password() {
  const [given, setGiven] = useState(EMPTY);
  const [execute, busy, error, result] = useRequest();
  const set = (name) => (event) => setGiven({ ...given, [name]: event.target.value });
  const differ = given.again !== "" && given.again !== given.new;
  const ready = given.old && given.new && given.again === given.new;
  const send = async (event) => {
    event.preventDefault();
    const found = await execute(() => api.post("/password", { old: given.old, new: given.new }));
    if (!found) return;
    session.value = found;
    setGiven(EMPTY);
  };
  const input = (name, auto, label, more = {}) => html`<${PasswordField} label=${t(label)} ...${more} autocomplete=${auto}
    value=${given[name]} onInput=${set(name)} />`;
  return html`<section class="panel"><h2>${t("page.password")}</h2><form class="stack narrow" onSubmit=${send}>
    ${input("old", "current-password", "page.password_old")}
    ${input("new", "new-password", "page.password_new", { help: passwordHelp() })}
    ${input("again", "new-password", "page.password_again",
      { wrong: differ && t("page.passwords_differ") })}
    <${ErrorNote} error=${error} />${result && html`<${Notice} kind="good" live>${t("page.password_changed")}<//>`}
    <div class="row"><button class="button main" type="submit" disabled=${busy
      || !ready}>${t("page.change_password")}</button></div></form></section>`;
}
