// REST client of /api/v1 with one kind of error. No request is repeated automatically.
import { signal } from "./lib.js";
import { t, localized } from "./i18n.js";

const API_ROOT = "/api/v1";
const REQUEST_TIMEOUT_MS = 15_000;

/** Answer of GET /session; null before it is known. Set by session.js. */
export const session = signal(null);

/** Error of a request: the server's error object, or that the server could not be reached. */
class ApiError extends Error {
  constructor(error, status) {
    super(error.code);
    this.code = error.code;
    this.kind = error.kind ?? "";
    this.params = error.params ?? {};
    this.outcome = error.outcome ?? null;
    this.text = error.text ?? null;
    this.status = status; // 0: no answer came
  }

  /** No answer came: the outcome of the request is unknown. */
  get unreachable() {
    return this.status === 0;
  }

  /** Text of the error in the reader's language. */
  get sentence() {
    return this.text === null ? t(this.code, this.params) : localized(this.text);
  }
}

/** A GET without an answer had no effect; the outcome of any other request is unknown. */
const unreachableError = (method) => new ApiError({
  code: method === "GET" ? "page.no_answer" : "page.unreachable", kind: "Unreachable",
}, 0);

async function errorFrom(answer) {
  const found = await answer.json().catch(() => ({}));
  const error = found.error ?? { code: "page.answer_unknown", params: { status: answer.status } };
  return new ApiError(error, answer.status);
}

function urlOf(path, query) {
  const search = new URLSearchParams();
  for (const [name, value] of Object.entries(query ?? {})) {
    if (value === null || value === undefined) continue;
    for (const item of Array.isArray(value) ? value : [value]) search.append(name, item);
  }
  return `${API_ROOT}${path}${search.size ? `?${search}` : ""}`;
}

async function send(method, path, { body, query, timeout_ms = REQUEST_TIMEOUT_MS, signal: abortSignal } = {}) {
  const headers = { Accept: "application/json" };
  if (body !== undefined) headers["Content-Type"] = "application/json";
  if (method !== "GET" && session.peek()?.csrf) headers["X-Drivebus-CSRF"] = session.peek().csrf;
  const timeout = AbortSignal.timeout(timeout_ms);
  const sessionBefore = session.peek();
  const request = {
    method, headers, signal: abortSignal ? AbortSignal.any([timeout, abortSignal]) : timeout,
    credentials: "same-origin", cache: "no-store", redirect: "error",
    body: body === undefined ? undefined : JSON.stringify(body),
  };
  const answer = await fetch(urlOf(path, query), request).catch(() => { throw unreachableError(method); });
  if (!answer.ok) throw followSession(await errorFrom(answer), sessionBefore);
  return answer;
}

/**
 * Change the session by the error of a request, and return the error: any 401 shows the login page, the refusal of an
 * idle session the form that unlocks it. A request that was sent before the session changed does not count: unlocking
 * replaces the cookie.
 */
function followSession(error, sessionBefore) {
  if (!session.peek()?.user || session.peek() !== sessionBefore) return error;
  if (error.status === 401) session.value = { ...session.peek(), user: null, rights: [] };
  else if (error.code === "auth.idle") session.value = { ...session.peek(), idle: true };
  return error;
}

async function sendJson(method, path, options) {
  const answer = await send(method, path, options);
  return answer.status === 204 ? {} : answer.json().catch(() => { throw unreachableError(method); });
}

/** `api.get("/drives")`, `api.post("/drives/fan-1/run", {frequency_hz: 25})`: JSON back, else ApiError. */
export const api = {
  get: (path, query, options) => sendJson("GET", path, { ...options, query }),
  post: (path, body = {}, options) => sendJson("POST", path, { ...options, body }),
  put: (path, body) => sendJson("PUT", path, { body }),
  patch: (path, body) => sendJson("PATCH", path, { body }),
  remove: (path) => sendJson("DELETE", path),
  /** The answer itself, for downloads. */
  raw: (path, query, options) => send("GET", path, { ...options, query }),
};

export const drivePath = (id, rest) => `/drives/${encodeURIComponent(id)}${rest}`;

export const groupPath = (id, rest) => `/groups/${encodeURIComponent(id)}${rest}`;
