"""Passes numbers on, and logs which OpenCL device it would render on."""

from __future__ import annotations

from opencl.device import choose_device
from pipeline.stage import Context, Input, Output, Parameters, stage


class WithDeviceParameters(Parameters):
    pass


@stage(inputs={"numbers": Input("numbers")}, outputs={"numbers": Output("numbers")}, version=1)
def with_device(context: Context, parameters: WithDeviceParameters) -> None:
    context.log(choose_device().name)
    context.output("numbers").write("values", context.input("numbers").read("values"))
