/** Where the time went: what the start cost, and training, evaluation, drawing and uploads since. */

import { send } from "../../lib/api.js";
import { duration } from "../../lib/format.js";
import { html, useEffect, useState } from "../../lib/html.js";
import { Prose } from "../../parts/elements.js";

const NAMES = { import: "import", trace: "trace", compile: "compile", first_update: "first update" };

/** The events {kind, time, number, …} of an answer of server-sent events. */
export function parseEvents(text) {
  return text.split("\n\n").flatMap((block) => {
    const kind = /^event: (.*)$/m.exec(block)?.[1];
    if (!kind) return [];
    const { time, data } = JSON.parse(/^data: (.*)$/m.exec(block)[1]);
    return [{ kind, time, number: /^id: (.*)$/m.exec(block)?.[1], ...data }];
  });
}

export function Costs({ job, onPhase }) {
  const [events, setEvents] = useState([]);
  useEffect(() => {
    // One that comes while the others are loaded may be among those.
    const add = (more) =>
      setEvents((known) => [...new Map([...known, ...more].map((event) => [event.number, event])).values()]);
    const stop = onPhase((event) => add([event]));
    send(`${job.links.events}?kind=phase&kind=note&kind=artifact&follow=false`)
      .then((answer) => answer.text())
      .then((text) => add(parseEvents(text)), () => {});
    return stop;
  }, [job.id]);
  const costs = costsOf(job, events);
  const notes = events.filter((event) => event.kind === "note" && event.text);
  const most = Math.max(...costs.map(([, spent]) => spent), 1e-9);
  return html`<section class="card"><h2>Phases and costs</h2>
    ${costs.length === 0 && html`<p class="facts">Nothing has ended yet.</p>`}
    <ul class="bars">
      ${costs.map(
        ([name, spent]) => html`<li key=${name}>
          <span>${name}</span>
          <svg class="bar" viewBox="0 0 100 8" preserveAspectRatio="none" aria-hidden="true"><rect width=${(100 * spent) / most} height="8" /></svg>
          <span class="facts">${duration(spent)}</span>
        </li>`,
      )}
    </ul>
    ${notes.map((note) => html`<p class="facts" key=${note.time}><${Prose} text=${note.text} /></p>`)}
  </section>`;
}

/** Pairs of a name and seconds. Phases add up over attempts; drawing runs beside the training. */
function costsOf(job, events) {
  const spent = new Map();
  const add = (name, more) => more > 0 && spent.set(name, (spent.get(name) || 0) + more);
  for (const event of events) if (typeof event.seconds === "number") add(NAMES[event.name] || event.name, event.seconds);
  const metrics = job.progress.metrics;
  add("train (act and learn)", metrics["training/walltime"]);
  add("evaluate", metrics["eval/walltime"]);
  const films = job.artifacts.filter((file) => file.role === "video");
  add("draw videos (beside it)", films.reduce((sum, film) => sum + (film.metadata.wall_s || 0), 0));
  add("upload (beside it)", events.reduce((sum, event) => sum + (event.upload_s || 0), 0));
  return [...spent];
}
