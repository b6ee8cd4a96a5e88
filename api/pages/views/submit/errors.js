/** Why a submission was refused; each place is a sentence, which also stands at its field. */

import { html } from "../../lib/html.js";

export const Errors = ({ problem, box }) =>
  html`<div class="failure" role="alert" tabindex="-1" ref=${box}>
    <h2>It was not submitted</h2>
    ${problem.errors?.length
      ? html`<ul>${problem.errors.map(({ pointer, detail }) => html`<li key=${pointer}><code>${pointer}</code> ${detail}</li>`)}</ul>`
      : html`<p>${problem.message}</p>`}
  </div>`;
