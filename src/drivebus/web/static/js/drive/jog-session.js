// A jog that lasts while its button or key is held. A release or a late renewal ends it.
import { api, drivePath } from "../api.js";
import { stop } from "../control/stops.js";
import { nowMs } from "../store.js";

const RENEW_EVERY_MS = 150;
/** The jog's lease in the service is 500 ms; a renewal that takes longer than this has failed. */
const RENEW_TIMEOUT_MS = 400;

const sleep = (ms) => new Promise((resolve) => { setTimeout(resolve, Math.max(0, ms)); });

/** One jog from press to release. `notify(phase, detail)`: "starting", "turning", "ending", "ended", "lost". `remark`: the
 * drive reported the other direction. */
export class JogSession {
  constructor(drive, body, notify) {
    this.drive = drive;
    this.path = (rest) => drivePath(drive, rest);
    this.body = body;
    this.notify = notify;
    this.isHeld = true;
    this.token = null;
    this.remark = null;
    this.released = new Promise((resolve) => { this.resolveRelease = resolve; });
  }

  /** Start the jog and renew it while it is held. Never raises. */
  async run() {
    this.notify("starting");
    try {
      const { jog, outcome } = await api.post(this.path("/jog"), this.body);
      this.token = jog;
      if (this.isHeld) this.notify("turning", outcome);
      await this.renewWhileHeld();
      await this.end();
    } catch (error) {
      this.isHeld = false;
      this.notify("lost", error);
      // The motor may still turn: the service ends the jog after half a second, and a stop follows.
      if (this.token !== null || error.unreachable) stop("drive", this.drive);
    }
  }

  async renewWhileHeld() {
    while (this.isHeld) {
      const begun = nowMs();
      const { remark } = await api.post(this.path("/jog/renew"), { jog: this.token }, { timeout_ms: RENEW_TIMEOUT_MS });
      if (remark && !this.remark) {
        this.remark = remark;
        if (this.isHeld) this.notify("turning");
      }
      await Promise.race([sleep(RENEW_EVERY_MS - (nowMs() - begun)), this.released]);
    }
  }

  async end() {
    this.notify("ending");
    const { outcome } = await api.post(this.path("/jog/end"), { jog: this.token });
    this.notify("ended", outcome);
  }

  /** End the jog at the release. Idempotent. */
  release() {
    this.isHeld = false;
    this.resolveRelease();
  }
}
