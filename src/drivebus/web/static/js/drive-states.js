// Groups of the states that a drive reports, as the service has them (`DriveState`).

/** States in which the drive turns, brakes or will turn the motor by itself. */
export const TURNING_STATES = ["running", "accelerating", "decelerating", "jogging", "braking", "restarting", "paused"];

/** States in which the output of a drive is off. */
export const OFF_STATES = ["stopped", "emergency_stopped", "fault", "not_ready"];

/** States in which the motor follows its set frequency: the only ones of a pause and a ramp hold. */
export const RUN_STATES = ["running", "accelerating", "decelerating"];
