/** The videos of several jobs side by side: at the same step of training, at the same moment. */

import { compact } from "../../lib/format.js";
import { html, useRef, useState } from "../../lib/html.js";
import { newest } from "../../lib/job.js";
import { filmName, filmsOf } from "../../parts/films.js";
import { useClock } from "./clock.js";

const SPEEDS = [0.1, 0.25, 0.5, 1, 2];

export function FilmsInStep({ jobs }) {
  const films = jobs.map(filmsOf);
  const steps = [...new Set(films.flat().map((film) => film.step ?? Infinity))].sort((a, b) => a - b);
  const [chosen, setChosen] = useState(null);
  const [speed, setSpeed] = useState(1);
  const box = useRef();
  const place = chosen === null ? steps.length - 1 : Math.min(chosen, steps.length - 1);
  const shown = films.map((own) => own.findLast((film) => (film.step ?? Infinity) <= steps[place]) || own[0]);
  const clock = useClock(box, speed, shown.map((film) => film?.href).join());
  if (!steps.length) return null;
  const text = steps[place] === Infinity ? "the end" : `step ${compact(steps[place])}`;
  return html`<section class="card stack" aria-label="Videos in step"><h2>Videos in step</h2>
    <div class="grid" ref=${box}>
      ${jobs.map((job, i) => html`<figure key=${job.id}>
        ${shown[i]
          ? html`<${Film} key=${shown[i].href} job=${job} film=${shown[i]} settle=${clock.settle} />`
          : html`<p class="state">${job.label} has no video.</p>`}
      </figure>`)}
    </div>
    <${Transport} clock=${clock} />
    <div class="tools">
      <label>Speed
        <select value=${speed} onChange=${(event) => setSpeed(Number(event.target.value))}>
          ${SPEEDS.map((one) => html`<option value=${one}>${one} ×</option>`)}
        </select>
      </label>
      ${steps.length > 1 && html`<label class="slider">Up to ${text}
        <input type="range" min="0" max=${steps.length - 1} value=${place} aria-valuetext=${text} onInput=${(event) => setChosen(Number(event.target.value))} />
      </label>`}
    </div>
  </section>`;
}

const Film = ({ job, film, settle }) => {
  const { width = 4, height = 3 } = film.metadata;
  return html`<video src=${film.href} poster=${newest(job, "poster", film.step)?.href} muted playsinline preload="metadata"
      aria-label="Video of ${job.label} ${filmName(film)}" style=${{ aspectRatio: `${width} / ${height}` }}
      onLoadedMetadata=${settle} onError=${settle}></video>
    <figcaption class="facts">${job.label}, ${filmName(film)}</figcaption>`;
};

const Transport = ({ clock: { time, duration, isPlaying, setPlaying, scrub } }) => html`<div class="transport">
  <button type="button" class="main" onClick=${() => setPlaying(!isPlaying)} aria-label=${isPlaying ? "Pause all" : "Play all"}>${isPlaying ? "❚❚" : "►"}</button>
  <label class="slider">
    <span class="facts">${time.toFixed(2)} s of ${duration.toFixed(2)} s</span>
    <input type="range" min="0" max=${duration} step="0.01" value=${time} aria-label="Moment" aria-valuetext="${time.toFixed(2)} s"
      onInput=${(event) => scrub(Number(event.target.value))} />
  </label>
</div>`;
