import { html } from "../lib/html.js";
export default () => html`<p class="state">Soon.</p>`;
