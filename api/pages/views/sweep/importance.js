/** The share of each axis in what makes trials differ. */

import { html } from "../../lib/html.js";

export function Importance({ sweep }) {
  const found = Object.entries(sweep.importance || {});
  return html`<section class="card"><h2>Importance of settings</h2>
    ${!found.length && html`<p class="facts">${sweep.importance_note || "It is computed once trials have succeeded."}</p>`}
    ${found.map(([metric, shares]) => html`<div key=${metric}>
      <p class="facts">for ${metric}, by PED-ANOVA</p>
      <ul class="bars">${Object.entries(shares).sort(([, one], [, other]) => other - one).map(([axis, share]) => html`<li key=${axis}>
        <span>${axis}</span>
        <svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true"><rect width=${100 * share} height="8" /></svg>
        <span class="facts">${Math.round(100 * share)} %</span>
      </li>`)}</ul>
    </div>`)}
  </section>`;
}
