/** Why a submission was refused; each place is a sentence, which also stands at its field. */

import { html } from "../../lib/html.js";
import { Prose } from "../../parts/prose.js";

export const Errors = ({ problem, errors, box }) =>
  html`<div class="failure" role="alert" tabindex="-1" ref=${box}>
    <h2>It was not submitted</h2>
    ${problem.errors?.length
      ? html`<ul>${errors.map(({ pointer, detail }) => html`<li key=${pointer}><code>${pointer}</code> <${Prose} text=${detail} /></li>`)}</ul>
          ${!errors.length && html`<p>All that was refused has been changed since.</p>`}`
      : html`<p><${Prose} text=${problem.message} /></p>`}
  </div>`;
