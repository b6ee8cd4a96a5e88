/** What a view shows instead of its content: loading, nothing there, an error, with what to do about it. */

import { html } from "../lib/html.js";
import { Prose } from "./prose.js";

export const Loading = ({ what }) => html`<p class="state" role="status">Loading ${what}…</p>`;

export const Empty = ({ children }) => html`<div class="state">${children}</div>`;

/** A refusal or an outage, and a way to try again. */
export const Failure = ({ error, again }) =>
  html`<div class="state failure" role="alert">
    <p><${Prose} text=${error.message} /></p>
    ${again && html`<button type="button" onClick=${again}>Try again</button>`}
  </div>`;
