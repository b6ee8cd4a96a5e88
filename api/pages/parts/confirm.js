/** A button that asks once more before it acts. */

import { html, useState } from "../lib/html.js";

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
