/** How busy a device was in the last day: a bar for each hour. */

import { html } from "../lib/html.js";

const HOUR = 3600;

/** The share of the time from the first hour until now, 0 to 1. usage: of `/usage`; seconds: of one of its devices. */
export function busyShare(usage, seconds) {
  const passed = (new Date(usage.until) - new Date(usage.hours[0])) / 1000;
  return seconds.reduce((sum, more) => sum + more, 0) / Math.max(passed, 1);
}

export const percent = (share) => (share > 0 && share < 0.005 ? "under 1 %" : `${Math.round(100 * Math.min(share, 1))} %`);

/** name: of the device, for those who do not see the picture. */
export function BusyHours({ usage, seconds, name }) {
  const hours = usage.hours.length;
  const share = percent(busyShare(usage, seconds));
  return html`<svg class="hours" viewBox="0 0 ${hours * 4} 20" preserveAspectRatio="none" role="img" aria-label="${name}: busy for ${share} of the last day">
    ${seconds.map((busy, hour) => {
      const height = Math.max(20 * Math.min(busy / HOUR, 1), busy > 0 ? 1 : 0);
      return html`<g key=${hour}><rect class="whole" x=${hour * 4} width="3" height="20" /><rect x=${hour * 4} y=${20 - height} width="3" height=${height} /></g>`;
    })}
  </svg>`;
}
