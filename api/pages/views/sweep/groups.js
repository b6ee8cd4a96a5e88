/** The seeds of each setting together: mean and standard deviation. */

import { value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { axesOf, objectivesOf, told } from "../../lib/sweep.js";

export function Groups({ sweep, objective }) {
  if (!sweep.groups.some((group) => group.trials.length > 1)) return null;
  const { metric, direction } = objectivesOf(sweep)[objective];
  const sign = direction === "minimize" ? 1 : -1;
  const worth = (group) => (group.mean[objective] === null ? Infinity : sign * group.mean[objective]);
  const groups = [...sweep.groups].sort((one, other) => worth(one) - worth(other));
  const axes = axesOf(sweep).filter((axis) => axis !== "seed");
  return html`<section class="card"><h2>Seeds of one setting together</h2>
    <div class="table" tabindex="0" role="region" aria-label="Seeds of one setting together"><table>
      <thead><tr>${axes.map((axis) => html`<th>${axis}</th>`)}<th class="number">Seeds</th><th class="number">${metric}</th></tr></thead>
      <tbody>${groups.map((group) => html`<tr key=${group.trials[0]}>
        ${axes.map((axis) => html`<td>${told(group.parameters[axis])}</td>`)}
        <td class="number">${group.trials.length}</td>
        <td class="number">${value(group.mean[objective])}${group.spread[objective] === null ? "" : ` ± ${value(group.spread[objective])}`}</td>
      </tr>`)}</tbody>
    </table></div>
  </section>`;
}
