/** The videos of several jobs side by side: at the same step of training, at the same moment. */

import { compact } from "../../lib/format.js";
import { html, useRef, useState } from "../../lib/html.js";
import { newest } from "../../lib/job.js";
import { filmName, filmsOf } from "../../parts/films.js";

export function FilmsInStep({ jobs }) {
  const films = jobs.map(filmsOf);
  const steps = [...new Set(films.flat().map((film) => film.step ?? Infinity))].sort((a, b) => a - b);
  const [chosen, setChosen] = useState(null);
  const box = useRef();
  if (!steps.length) return null;
  const place = chosen === null ? steps.length - 1 : Math.min(chosen, steps.length - 1);
  const shown = films.map((own) => own.findLast((film) => (film.step ?? Infinity) <= steps[place]) || own[0]);
  const players = () => [...box.current.querySelectorAll("video")];
  const play = () => {
    const all = players();
    all.forEach((player) => (player.currentTime = 0));
    all.forEach((player) => player.play());
  };
  const text = steps[place] === Infinity ? "the end" : `step ${compact(steps[place])}`;
  return html`<section class="card"><h2>Videos in step</h2>
    <div class="tools">
      ${steps.length > 1 && html`<label class="slider">Up to ${text}
        <input type="range" min="0" max=${steps.length - 1} value=${place} aria-valuetext=${text} onInput=${(event) => setChosen(Number(event.target.value))} />
      </label>`}
      <button type="button" onClick=${play}>Play all from the start</button>
      <button type="button" onClick=${() => players().forEach((player) => player.pause())}>Pause all</button>
    </div>
    <div class="grid" ref=${box}>
      ${jobs.map((job, i) => html`<figure key=${job.id}>
        ${shown[i]
          ? html`<video src=${shown[i].href} poster=${newest(job, "poster", shown[i].step)?.href} muted loop playsinline controls preload="metadata" aria-label="Video of ${job.label} ${filmName(shown[i])}"></video>
              <figcaption class="facts">${job.label}, ${filmName(shown[i])}</figcaption>`
          : html`<p class="state">${job.label} has no video.</p>`}
      </figure>`)}
    </div>
  </section>`;
}
