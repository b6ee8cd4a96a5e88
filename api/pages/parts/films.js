/** A job's videos: a slider through the checkpoints that have one. */

import { count } from "../lib/format.js";
import { html, useEffect, useRef, useState } from "../lib/html.js";
import { newest, ofSeed } from "../lib/job.js";

/** The job's videos by step; the one made at its end has no step and comes last. */
export const filmsOf = (job) =>
  ofSeed(job).artifacts.filter((file) => file.role === "video").sort((a, b) => (a.step ?? Infinity) - (b.step ?? Infinity));

export const filmName = (film) => (film.step === null ? "at the end" : `at step ${count(film.step)}`);

/** Children: what stands there while the job has no video. */
export function Films({ job, onStep, children }) {
  const films = filmsOf(job);
  const [chosen, setChosen] = useState(null); // null: the newest, also when another comes.
  const player = useRef();
  const at = useRef(0);
  const place = chosen === null ? films.length - 1 : Math.min(chosen, films.length - 1);
  const film = films[place];
  useEffect(() => onStep?.(film?.step ?? null), [film?.name]);
  if (!film) return html`${children}<${NoFilm} job=${job} />`;
  const choose = (event) => {
    const next = Number(event.target.value);
    at.current = player.current?.currentTime || 0;
    setChosen(next === films.length - 1 ? null : next);
  };
  // The next film goes on where this one was, so that the same moment of both is compared.
  const resume = (event) => (event.target.currentTime = Math.min(at.current, event.target.duration || 0));
  const poster = newest(job, "poster", film.step);
  const { width = 4, height = 3 } = film.metadata;
  return html`<div class="films">
    <video key=${film.name} ref=${player} src=${film.href} poster=${poster?.href} controls loop muted playsinline autoplay
      preload="metadata" aria-label="Video ${filmName(film)}" onLoadedMetadata=${resume}
      style=${{ aspectRatio: `${width} / ${height}` }}></video>
    ${films.length > 1
      ? html`<label class="slider">
          <span class="facts">Video ${filmName(film)} (${place + 1} of ${films.length})</span>
          <input type="range" min="0" max=${films.length - 1} value=${place} onInput=${choose} aria-valuetext=${filmName(film)} />
        </label>`
      : html`<p class="facts">Video ${filmName(film)}</p>`}
  </div>`;
}

function NoFilm({ job }) {
  const text =
    job.spec.video === null
      ? "This job asks for no video."
      : ["succeeded", "failed", "cancelled"].includes(job.status)
        ? `The job ended without a video.${newest(job, "replay") ? ` The replay shows the same${job.kind === "train" ? ", and a rollout draws one" : ""}.` : ""}`
        : job.progress.phase === "drawing"
          ? "The video is drawn now."
          : job.kind === "train" && !job.spec.video?.every_checkpoint
            ? "The video is made at the end. A job with “every_checkpoint” has one for each checkpoint."
            : "No video yet: the first one comes with the first checkpoint.";
  return html`<p class="state">${text}</p>`;
}
