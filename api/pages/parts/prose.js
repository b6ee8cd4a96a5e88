/** A sentence of the service as people read it. */

import { html } from "../lib/html.js";

/** Text in which backticks mark code. */
export const Prose = ({ text }) =>
  html`${text.split("`").map((part, number) => (number % 2 ? html`<code>${part}</code>` : part))}`;
