/** The test of a job's policy in C MuJoCo under several commands, or on the clips that it follows (docs/battery.md). */

import { count, value } from "../../lib/format.js";
import { html } from "../../lib/html.js";
import { newest } from "../../lib/job.js";
import { ClipErrors } from "./clip_errors.js";

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
  reached: "To the end",
  root_error: "Root, m",
  joint_error: "Joints, rad",
};
const isLeast = (quantity) => quantity.endsWith("tracking") || quantity === "reached";
const isShare = (quantity) => quantity === "falls" || quantity === "reached";
const shown = (number, digits = 2) => (typeof number === "number" ? number.toFixed(digits) : "–");
const ERRORS = ["root_error", "joint_error"]; // To the millimetre: a rat's bound may be a centimetre.
const inWords = ({ quantity, value: number }) => (isShare(quantity) ? percent(number) : shown(number, ERRORS.includes(quantity) ? 3 : 2));

/** Nothing for a job without one; an imported job's facts may hold anything. */
export function Battery({ job }) {
  const file = newest(job, "battery");
  const { passed, criteria, commands, clips, spec } = file?.metadata || {};
  if (!Array.isArray(commands) || !Array.isArray(criteria)) return null;
  const isOfClips = Array.isArray(clips) && clips.length > 0;
  return html`<section class="card" aria-label="Battery"><h2>Battery: ${passed ? "passed" : "not passed"}</h2>
    <ul class="plain">${criteria.map(
      (one) => html`<li key=${one.quantity}>${one.met ? "✓" : "✗"} ${NAMES[one.quantity] || one.quantity}: ${inWords(one)}
        <span class="facts"> ${isLeast(one.quantity) ? "at least" : "at most"} ${isShare(one.quantity) ? percent(one.bound) : value(one.bound)}</span></li>`,
    )}</ul>
    ${isOfClips ? html`<${Clips} clips=${clips} />` : html`<${Commands} commands=${commands} />`}
    ${isOfClips && html`<${ClipErrors} file=${file} />`}
    <p class="facts">In C MuJoCo with the model's own solver, ${isOfClips ? "each clip to its end" : `${value(spec?.seconds)} s each`}${spec?.push ? ", with pushes" : ""}. <a href=${file.href} download=${file.name}>All of it</a></p>
  </section>`;
}

function Clips({ clips }) {
  return html`<div class="table" tabindex="0" role="region" aria-label="Clips"><table>
    <thead><tr><th>Clip</th><th class="number">${NAMES.reached}</th>${ERRORS.map((name) => html`<th key=${name} class="number">${NAMES[name]}</th>`)}</tr></thead>
    <tbody>${clips.map(
      (row) => html`<tr key=${row.clip}>
        <td>${row.clip}</td>
        <td class="number">${percent(row.reached)} of ${count(row.episodes)}</td>
        ${ERRORS.map((name) => html`<td key=${name} class="number">${shown(row[name], 3)}</td>`)}
      </tr>`,
    )}</tbody>
  </table></div>`;
}

function Commands({ commands }) {
  return html`<div class="table" tabindex="0" role="region" aria-label="Commands"><table>
      <thead><tr><th>Forward, left, turn</th><th class="number">Falls</th><th class="number">Velocity</th><th class="number">Turning</th>
        ${SMOOTHNESS.map((name) => html`<th key=${name} class="number">${NAMES[name]}</th>`)}</tr></thead>
      <tbody>${commands.map(
        (row) => html`<tr key=${String(row.command)}>
          <td>${(row.command || []).map(value).join(", ")}</td>
          <td class="number">${count(row.falls)} of ${count(row.episodes)}</td>
          ${["linear_tracking", "angular_tracking", ...SMOOTHNESS].map((name) => html`<td key=${name} class="number">${shown(row[name])}</td>`)}
        </tr>`,
      )}</tbody>
    </table></div>`;
}

const percent = (share) => (typeof share === "number" ? `${value(100 * share)} %` : "–");
