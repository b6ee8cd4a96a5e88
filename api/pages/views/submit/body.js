/** Stills of the body before any training, drawn by a worker. */

import { send } from "../../lib/api.js";
import { html, useEffect, useState } from "../../lib/html.js";
import { Prose } from "../../parts/prose.js";

const SETTLE_MS = 600;
const PAUSE_MS = 2000;

/** The preview's document once the stills are drawn. tell: says meanwhile why there are none. */
async function drawn(path, signal, tell) {
  for (;;) {
    try {
      const answer = await send(path, { signal });
      if (answer.status !== 202) return await answer.json();
      tell("A worker draws it…");
    } catch (error) {
      if (error.status !== 503) throw error; // No worker yet, or too much to draw: that passes.
      tell(error.message);
    }
    await new Promise((resolve) => setTimeout(resolve, PAUSE_MS));
  }
}

export function Body({ environment }) {
  const [state, setState] = useState({});
  const options = JSON.stringify(environment.options || {});
  useEffect(() => {
    const control = new AbortController();
    const tell = (text) => control.signal.aborted || setState({ text });
    tell("A worker draws it…");
    const timer = setTimeout(() => {
      const query = new URLSearchParams({ options, width: 320, height: 240 });
      drawn(`/environments/${environment.id}/preview?${query}`, control.signal, tell).then(
        (preview) => setState({ preview }),
        (error) => control.signal.aborted || setState({ error }),
      );
    }, SETTLE_MS);
    return () => {
      clearTimeout(timer);
      control.abort();
    };
  }, [environment.id, options]);
  const { preview, error, text } = state;
  return html`<section class="card" aria-label="The body"><h2>${environment.id}</h2>
    ${text && html`<p class="facts" role="status"><${Prose} text=${text} /></p>`}
    ${error && html`<p class="facts"><${Prose} text=${error.message} /></p>`}
    ${preview && html`<div class="stills">${preview.stills.map(
      (still) => html`<figure key=${still.href}><img src=${still.href} alt="${environment.id}, camera ${still.camera}" /><figcaption>${still.camera}</figcaption></figure>`,
    )}</div>`}
  </section>`;
}
