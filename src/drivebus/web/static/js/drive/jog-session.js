// A jog that lasts while its button or key is held. A release or a late renewal ends it.
import { api, drivePath } from "../api.js";
import { stop } from "../stops.js";
import { nowMs } from "../store.js";

const RENEW_EVERY_MS = 150;
/** The drive's lease is 500 ms; an answer that takes longer than this comes too late to rely on. */
const RENEW_TIMEOUT_MS = 400;

const sleep = (ms) => new Promise((resolve) => { setTimeout(resolve, Math.max(0, ms)); });

/** One jog from press to release. `tell(phase, detail)`: "asking", "turning", "ending", "ended", "lost". */
export class JogSession {
  constructor(drive, body, notify) {
    this.drive = drive;
    this.path = (rest) => drivePath(drive, rest);
    this.body = body;
    this.tell = notify;
    this.isHeld = true;
    this.word = null;
    this.gone = new Promise((resolve) => { this.resolveRelease = resolve; });
  }

  /** Begins, and renews while it is held. Never raises. */
  async run() {
    this.tell("asking");
    try {
      const { jog, outcome } = await api.post(this.path("/jog"), this.body);
      this.word = jog;
      if (this.isHeld) this.tell("turning", outcome);
      await this.renewWhileHeld();
      await this.end();
    } catch (error) {
      this.isHeld = false;
      this.tell("lost", error);
      // The motor may still turn: the drive's own lease ends it in half a second, and a stop follows.
      if (this.word !== null || error.unreachable) stop("drive", this.drive);
    }
  }

  async renewWhileHeld() {
    while (this.isHeld) {
      const begun = nowMs();
      await api.post(this.path("/jog/renew"), { jog: this.word }, { patience_ms: RENEW_TIMEOUT_MS });
      await Promise.race([sleep(RENEW_EVERY_MS - (nowMs() - begun)), this.gone]);
    }
  }

  async end() {
    this.tell("ending");
    const { outcome } = await api.post(this.path("/jog/end"), { jog: this.word });
    this.tell("ended", outcome);
  }

  /** End the jog at the release. Idempotent. */
  release() {
    this.isHeld = false;
    this.resolveRelease();
  }
}
