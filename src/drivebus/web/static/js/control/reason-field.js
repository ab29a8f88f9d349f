// Input of a reason, which the audit trail keeps. The lengths are the service's.
import { html } from "../lib.js";
import { Field } from "../ui.js";

const MIN_LENGTH = 3;
const MAX_LENGTH = 500;

export const isLongEnough = (reason) => reason.trim().length >= MIN_LENGTH;

export const ReasonField = ({ label, help, value, onChange, ...rest }) => html`<${Field} label=${label} help=${help}><input value=${value}
  minlength=${MIN_LENGTH} maxlength=${MAX_LENGTH} onInput=${(event) => onChange(event.currentTarget.value)} ...${rest} /><//>`;
