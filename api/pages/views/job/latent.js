/** The latent space of a recorded rollout: each step in the plane of a layer's two principal components. */

import { get } from "../../lib/api.js";
import { count, value } from "../../lib/format.js";
import { html, useState } from "../../lib/html.js";
import { useLive } from "../../lib/live.js";
import { Failure, Loading } from "../../parts/elements.js";

const [WIDTH, HEIGHT, LEFT, RIGHT, TOP, BELOW] = [360, 290, 52, 10, 10, 44];
const MOST_NAMED = 8; // As many colours as there are for curves.

const COLOURS = {
  share: ["Share of the clip", (found, at) => found.share[at]],
  clip: ["Clip", (found, at) => found.clip[at]],
  time_s: ["Time in the episode", (found, at) => found.time_s[at]],
  episode: ["Episode", (found, at) => found.episode[at]],
};

/** Nothing for a job without one. */
export function Latent({ job }) {
  const file = job.artifacts.find(({ name }) => name === "latent.json");
  if (!file) return null;
  return html`<section class="card" aria-label="Latent space"><h2>Latent space</h2><${Loaded} file=${file} /></section>`;
}

function Loaded({ file }) {
  const { data, error, again } = useLive((signal) => get(file.href, {}, { signal }), [file.sha256]);
  const [chosen, choose] = useState(null);
  if (error) return html`<${Failure} error=${error} again=${again} />`;
  if (!data) return html`<${Loading} what="the latent space" />`;
  if (!Array.isArray(data.x) || !Array.isArray(data.variance)) return html`<p class="facts">The file holds none.</p>`;
  const kinds = Object.keys(COLOURS).filter((kind) => Array.isArray(data[kind]));
  const kind = chosen || kinds[0];
  return html`<div class="tools"><label>Colour
      <select aria-label="Colour" value=${kind} onChange=${(event) => choose(event.target.value)}>${kinds.map((one) => html`<option key=${one} value=${one}>${COLOURS[one][0]}</option>`)}</select>
    </label></div>
    <${Picture} found=${data} kind=${kind} />
    <p class="facts">${count(data.x.length)} steps of <code>${data.layer}</code> (${data.size} numbers), in the plane of its two principal components.</p>`;
}

function Picture({ found, kind }) {
  const x = scale(found.x, LEFT, WIDTH - RIGHT);
  const y = scale(found.y, HEIGHT - BELOW, TOP);
  const of = (at) => COLOURS[kind][1](found, at);
  const numbers = found[kind];
  const isNamed = kind === "clip" || kind === "episode";
  const most = Math.max(...numbers, 1e-9);
  const colour = (one) => (isNamed ? named(one) : shade(one / (kind === "share" ? 1 : most)));
  const axis = (at) => `component ${at + 1}, ${Math.round(100 * found.variance[at])} % of the variance`;
  const said = `${count(found.x.length)} steps of ${found.layer}; across ${axis(0)}, up ${axis(1)}; coloured by ${COLOURS[kind][0].toLowerCase()}`;
  return html`<svg class="sweep-picture latent" viewBox="0 0 ${WIDTH} ${HEIGHT}" role="img" aria-label=${said}>
      ${y.ends.map((one) => html`<g key=${one}><line x1=${LEFT} x2=${WIDTH - RIGHT} y1=${y(one)} y2=${y(one)} /><text x=${LEFT - 6} y=${y(one) + 4} text-anchor="end">${value(Number(one.toPrecision(2)))}</text></g>`)}
      ${x.ends.map((one) => html`<g key=${one}><line x1=${x(one)} x2=${x(one)} y1=${TOP} y2=${HEIGHT - BELOW} /><text x=${x(one)} y=${HEIGHT - BELOW + 16} text-anchor="middle">${value(Number(one.toPrecision(2)))}</text></g>`)}
      <text x=${(LEFT + WIDTH - RIGHT) / 2} y=${HEIGHT - 6} text-anchor="middle">${axis(0)}</text>
      <text transform="translate(12 ${(TOP + HEIGHT - BELOW) / 2}) rotate(-90)" text-anchor="middle">${axis(1)}</text>
      ${found.x.map((one, at) => html`<circle key=${at} cx=${x(one).toFixed(1)} cy=${y(found.y[at]).toFixed(1)} r="2.2" style=${{ fill: colour(of(at)) }} />`)}
    </svg>
    ${isNamed ? html`<${Names} found=${found} kind=${kind} />` : html`<p class="facts scale">${kind === "share" ? "begin" : "0"}
      <svg viewBox="0 0 20 1" preserveAspectRatio="none" aria-hidden="true">${[...Array(20)].map((_, step) => html`<rect key=${step} x=${step} width="1" height="1" style=${{ fill: shade((step + 0.5) / 20) }} />`)}</svg>
      ${kind === "share" ? "end" : `${value(most)} s`}</p>`}`;
}

function Names({ found, kind }) {
  const present = [...new Set(found[kind])].sort((one, other) => one - other);
  return html`<ul class="legend">${present.slice(0, MOST_NAMED).map(
    (one) => html`<li key=${one}><svg viewBox="0 0 10 10" aria-hidden="true"><circle cx="5" cy="5" r="5" style=${{ fill: named(one) }} /></svg> ${kind === "clip" ? found.clips[one] : `episode ${one + 1}`}</li>`,
  )}${present.length > MOST_NAMED && html`<li class="facts">and ${present.length - MOST_NAMED} more, whose colours repeat</li>`}</ul>`;
}

const named = (one) => `var(--curve-${(one % MOST_NAMED) + 1})`;

/** From violet to red, equally bright, so that it is seen on light and on dark. */
const shade = (share) => `oklch(0.64 0.17 ${300 - 275 * share})`;

/** The place of a number between two edges, and ends that all numbers lie between. */
function scale(numbers, from, to) {
  const [low, high] = [Math.min(...numbers), Math.max(...numbers)];
  const room = 0.04 * (high - low) || 1;
  const place = (one) => from + ((one - low + room) / (high - low + 2 * room)) * (to - from);
  return Object.assign(place, { ends: high > low ? [low, high] : [low] });
}
