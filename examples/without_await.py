"""Run, read and stop one drive without ``await``, for scripts and notebooks. 不用 await，供脚本和 notebook 使用。"""

from drivebus import blocking

with blocking.open_bus("sim://vc660@1", baud=19200) as bus:
    spindle = blocking.Drive(bus, "vc660", 1)
    print("run:", spindle.run(10.0, "reverse", wait=True))
    print("current:", spindle.read(["output_current"])["output_current"].value, "A")
    print("stop:", spindle.stop())
