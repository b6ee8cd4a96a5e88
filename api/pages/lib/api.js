/** Requests to the service, and whether it answers. */

import { useEffect, useState } from "./html.js";

/** A refusal (RFC 9457). `errors`: [{pointer, detail}], the places that it names. */
export class Problem extends Error {
  constructor(status, document) {
    super(document.detail || document.title || `The service answered with status ${status}.`);
    this.status = status;
    this.type = document.type || "";
    this.errors = document.errors || [];
  }
}

/** The service did not answer. */
export class Away extends Error {
  constructor() {
    super("The service does not answer.");
  }
}

/**
 * The answer to a request. Raises Problem, Away; AbortError where `signal` ended it.
 * maxAge: seconds; the answer may be one that another reader got in this time. range: [first, last] byte wanted.
 */
export async function send(path, { method = "GET", body, type, signal, maxAge, range } = {}) {
  let answer;
  const headers = {
    ...(method !== "GET" && { "X-Gaitway-Page": "1" }), // No other site's page can send this header.
    ...(type && { "Content-Type": type }),
    ...(maxAge && { "Cache-Control": `max-age=${maxAge}` }),
    ...(range && { Range: `bytes=${range.join("-")}` }),
  };
  try {
    answer = await fetch(path, { method, body, signal, headers });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    report(false);
    throw new Away();
  }
  report(true);
  if (answer.ok) return answer;
  if (answer.status === 401) signedOut();
  throw new Problem(answer.status, await answer.json().catch(() => ({})));
}

/** The JSON document at a path. query: an object or URLSearchParams; empty values are left out. */
export async function get(path, query = {}, { signal, maxAge } = {}) {
  return (await send(withQuery(path, query), { signal, maxAge })).json();
}

const MOST = 200; // Items a page, as the service allows.

/** Every item of a listing, page after page. */
export async function everyItem(path, options) {
  const items = [];
  let cursor = null;
  do {
    const page = await get(path, { cursor, limit: MOST }, options);
    items.push(...page.items);
    cursor = page.next;
  } while (cursor);
  return items;
}

/** The answer's document, or null if it has none. */
export const post = (path, document) => sendDocument("POST", path, document);

/** The thing's document after these changes. */
export const patch = (path, changes) => sendDocument("PATCH", path, changes);

async function sendDocument(method, path, document) {
  const body = document === undefined ? undefined : JSON.stringify(document);
  return (await send(path, { method, body, type: body && "application/json" })).json();
}

export const remove = (path) => send(path, { method: "DELETE" });

/** A path with the query's values that are not empty; lists repeat their name. */
export function withQuery(path, query) {
  const pairs = query instanceof URLSearchParams ? [...query] : Object.entries(query);
  const said = new URLSearchParams();
  for (const [name, value] of pairs) {
    for (const one of [value].flat()) {
      if (one !== undefined && one !== null && one !== "") said.append(name, one);
    }
  }
  return said.size ? `${path}?${said}` : path;
}

const onSignedOutListeners = new Set();

/** Nobody is signed in any more, as far as a request showed. */
export const signedOut = () => onSignedOutListeners.forEach((listener) => listener());

/** Call a listener when that is so. Returns a function that stops it. */
export function onSignedOut(listener) {
  onSignedOutListeners.add(listener);
  return () => onSignedOutListeners.delete(listener);
}

const listeners = new Set();
let away = false;

/** @param {boolean} answered Whether the service gave any answer at all. */
export function report(answered) {
  if (away === !answered) return;
  away = !answered;
  for (const listener of listeners) listener(away);
}

/** True while the service does not answer. */
export function useAway() {
  const [value, setValue] = useState(away);
  useEffect(() => {
    listeners.add(setValue);
    return () => listeners.delete(setValue);
  }, []);
  return value;
}
