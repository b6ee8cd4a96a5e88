/** Small parts of any view: prose, text to copy, a question before an act, pages of a list, and what stands for content that is not there. */

import { html, useState } from "../lib/html.js";
import { href } from "../lib/route.js";

/** Text in which backticks mark code. */
export const Prose = ({ text }) =>
  html`${text.split("`").map((part, number) => (number % 2 ? html`<code>${part}</code>` : part))}`;

/** What a worker said of a file that was sent, or that none has read it yet. */
export function Said({ file }) {
  const text = file.message || (file.status === "validating" && "No worker has read it yet; a busy one does so after its job.");
  return text && html`<p class=${file.status === "refused" ? "error" : "facts"}><${Prose} text=${text} /></p>`;
}

export const Loading = ({ what }) => html`<p class="state" role="status">Loading ${what}…</p>`;

export const Empty = ({ children }) => html`<div class="state">${children}</div>`;

/** A refusal or an outage, and a way to try again. */
export const Failure = ({ error, again }) =>
  html`<div class="state failure" role="alert">
    <p><${Prose} text=${error.message} /></p>
    ${again && html`<button type="button" onClick=${again}>Try again</button>`}
  </div>`;

export function Copy({ text, name }) {
  const [said, setSaid] = useState("Copy");
  const copy = async () => {
    // Browsers offer the clipboard only to pages from this machine or over TLS.
    const done = await navigator.clipboard?.writeText(text).then(() => true, () => false);
    setSaid(done ? "Copied" : "Select it and copy");
    setTimeout(() => setSaid("Copy"), 2000);
  };
  return html`<div class="copy">
    <pre tabindex="0" role="region" aria-label=${name}>${text}</pre>
    <button type="button" onClick=${copy} aria-label="${said}: ${name}">${said}</button>
  </div>`;
}

export function Confirm({ text, question, onYes, isDangerous }) {
  const [isAsking, setAsking] = useState(false);
  if (!isAsking) {
    return html`<button type="button" class=${isDangerous ? "danger" : ""} onClick=${() => setAsking(true)}>${text}</button>`;
  }
  return html`<span class="actions" role="group" aria-label=${question}>
    <span class="facts">${question}</span>
    <button type="button" class="danger" ref=${(button) => button?.focus()} onClick=${() => (setAsking(false), onYes())}>Yes, ${text.toLowerCase()}</button>
    <button type="button" onClick=${() => setAsking(false)}>No</button>
  </span>`;
}

/**
 * Links to the first page and to the next one, by the cursor in the address.
 * path, query: of the present address. next: the listing's. first, more: what the links say.
 */
export function Pages({ path, query, next, first, more, name }) {
  if (!query.get("cursor") && !next) return null;
  const at = (cursor) => {
    const parts = new URLSearchParams(query);
    parts.delete("cursor");
    if (cursor) parts.set("cursor", cursor);
    return href(path, parts);
  };
  return html`<nav class="pages" aria-label=${name}>
    ${query.get("cursor") && html`<a href=${at(null)}>${first}</a>`} ${next && html`<a href=${at(next)} rel="next">${more}</a>`}
  </nav>`;
}
