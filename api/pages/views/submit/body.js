/** Stills of the body before any training, drawn by a worker. */

import { send } from "../../lib/api.js";
import { html, useEffect, useState } from "../../lib/html.js";

const SETTLE_MS = 600;

/** The preview's document once the stills are drawn. */
async function drawn(path, signal) {
  for (;;) {
    const answer = await send(path, { signal });
    const document = await answer.json();
    if (answer.status !== 202) return document;
    await new Promise((resolve) => setTimeout(resolve, 1000 * Number(answer.headers.get("Retry-After") || 2)));
  }
}

export function Body({ environment }) {
  const [state, setState] = useState({});
  const options = JSON.stringify(environment.options || {});
  useEffect(() => {
    const control = new AbortController();
    setState({ isDrawing: true });
    const timer = setTimeout(() => {
      const query = new URLSearchParams({ options, width: 320, height: 240 });
      drawn(`/environments/${environment.id}/preview?${query}`, control.signal).then(
        (preview) => setState({ preview }),
        (error) => control.signal.aborted || setState({ error }),
      );
    }, SETTLE_MS);
    return () => {
      clearTimeout(timer);
      control.abort();
    };
  }, [environment.id, options]);
  const { preview, error, isDrawing } = state;
  return html`<section class="card" aria-label="The body"><h2>${environment.id}</h2>
    ${isDrawing && html`<p class="facts" role="status">A worker draws it…</p>`}
    ${error && html`<p class="facts">${error.message}</p>`}
    ${preview && html`<div class="stills">${preview.stills.map(
      (still) => html`<figure key=${still.href}><img src=${still.href} alt="${environment.id}, camera ${still.camera}" /><figcaption>${still.camera}</figcaption></figure>`,
    )}</div>`}
  </section>`;
}
