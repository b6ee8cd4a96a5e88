/** Text to copy, with a button that does. */

import { html, useState } from "../lib/html.js";

export function Copy({ text, name }) {
  const [said, setSaid] = useState("Copy");
  const copy = async () => {
    // Browsers offer the clipboard only to pages from this machine or over TLS.
    const done = await navigator.clipboard?.writeText(text).then(() => true, () => false);
    setSaid(done ? "Copied" : "Select it and copy");
    setTimeout(() => setSaid("Copy"), 2000);
  };
  return html`<div class="copy">
    <pre tabindex="0" role="region" aria-label=${name}>${text}</pre>
    <button type="button" onClick=${copy} aria-label="${said}: ${name}">${said}</button>
  </div>`;
}
