/** The test of a job's policy in C MuJoCo under several commands (docs/battery.md). */

import { count, value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { newest } from "../../lib/job.js";

const SMOOTHNESS = ["action_change", "target_change", "torso_rate", "yaw_rate", "leg_velocity"];
const NAMES = {
  falls: "Falls",
  linear_tracking: "Velocity",
  angular_tracking: "Turning",
  action_change: "Action change",
  target_change: "Target change, rad",
  torso_rate: "Torso, rad/s",
  yaw_rate: "Yaw, rad/s",
  leg_velocity: "Legs, rad/s",
};
const isLeast = (quantity) => quantity.endsWith("tracking");
const shown = (number) => (typeof number === "number" ? number.toFixed(2) : "–");

/** Nothing for a job without one; an imported job's facts may hold anything. */
export function Battery({ job }) {
  const file = newest(job, "battery");
  const { passed, criteria, commands, spec } = file?.metadata || {};
  if (!Array.isArray(commands) || !Array.isArray(criteria)) return null;
  return html`<section class="card" aria-label="Battery"><h2>Battery: ${passed ? "passed" : "not passed"}</h2>
    <ul class="plain">${criteria.map(
      (one) => html`<li key=${one.quantity}>${one.met ? "✓" : "✗"} ${NAMES[one.quantity] || one.quantity}: ${one.quantity === "falls" ? percent(one.value) : shown(one.value)}
        <span class="facts"> ${isLeast(one.quantity) ? "at least" : "at most"} ${one.quantity === "falls" ? percent(one.bound) : value(one.bound)}</span></li>`,
    )}</ul>
    <div class="table" tabindex="0" role="region" aria-label="Commands"><table>
      <thead><tr><th>Forward, left, turn</th><th class="number">Falls</th><th class="number">Velocity</th><th class="number">Turning</th>
        ${SMOOTHNESS.map((name) => html`<th key=${name} class="number">${NAMES[name]}</th>`)}</tr></thead>
      <tbody>${commands.map(
        (row) => html`<tr key=${String(row.command)}>
          <td>${(row.command || []).map(value).join(", ")}</td>
          <td class="number">${count(row.falls)} of ${count(row.episodes)}</td>
          ${["linear_tracking", "angular_tracking", ...SMOOTHNESS].map((name) => html`<td key=${name} class="number">${shown(row[name])}</td>`)}
        </tr>`,
      )}</tbody>
    </table></div>
    <p class="facts">In C MuJoCo with the model's own solver, ${value(spec?.seconds)} s each${spec?.push ? ", with pushes" : ""}. <a href=${file.href} download=${file.name}>All of it</a></p>
  </section>`;
}

const percent = (share) => (typeof share === "number" ? `${value(100 * share)} %` : "–");
