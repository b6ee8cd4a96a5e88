/** How much the sweep will do, before it is started. */

import { html } from "../../lib/html.js";
import { MOST_TRIALS, sizeOf } from "../../lib/sweep_size.js";

const UNKNOWN = {
  grid: "How many trials it has is known once each axis has its values.",
  pbt: "How many trials it has is known once the population has generations.",
};
const BY_BUDGET = "How many trials it has depends on the budget.";

export function Size({ document, known, environment }) {
  const { trials, each, dependsOnDevice, steps, isMost } = sizeOf(document, known, environment);
  const parallel = document.budget?.parallel ?? 4;
  return html`<section class="card" aria-label="Size" role="status"><h2>${trials === null ? "Size" : `${number(trials)} trial${trials === 1 ? "" : "s"}`}</h2>
    ${trials === null && html`<p class="facts">${UNKNOWN[document.method] ?? BY_BUDGET}</p>`}
    ${trials > MOST_TRIALS && html`<p class="error">A sweep has ${number(MOST_TRIALS)} trials at most: take fewer values, or random draws.</p>`}
    <ul class="facts">
      ${each !== null && html`<li>${dependsOnDevice ? "up to " : ""}${number(each)} environment steps each${dependsOnDevice ? ", depending on the device" : ""}</li>`}
      ${steps !== null && html`<li>${number(Math.round(steps))} steps in all${isMost ? ", at most" : ""}</li>`}
      ${trials !== null && html`<li>${number(Math.min(parallel, trials))} at the same time</li>`}
    </ul>
  </section>`;
}

const number = (value) => value.toLocaleString("en");
