"""`recover`: undo the motion and feature mixing of a found container, so that its owner's secret can read it."""

from __future__ import annotations

import torch
from pydantic import Field

from pipeline.artifact import Artifact
from pipeline.errors import UserError
from pipeline.stage import Context, Input, Output, Parameters, stage
from stages.analysis.measurements import KIND, Measurement, write_measurements
from stages.analysis.verdicts import IS_YOURS, MAY_BE_YOURS
from stages.hiding.method_names import MethodName, module_of
from stages.hiding.recovery import Recovery, TooFewPairs, recovered, unlike
from stages.hiding.storage import check_method, read_gaussians, read_method, write_container
from stages.scene.gaussians import Gaussians
from stages.training.threads import Threads

LISTED = 10  # rows named in an error
AS_FOUND = "as_found"


class RecoverParameters(Parameters):
    """The method of the containers, and the seed of the search for a motion."""

    method: MethodName = Field("gs_hider", description="The method of both containers; plain for splats of 3DGS.")
    seed: int = Field(
        0, ge=0, description="Random seed for the Gaussians and motions tried if positions alone do not match."
    )
    threads: Threads = 1


@stage(
    inputs={"found": Input("container or splats"), "published": Input("container or splats")},
    outputs={"container": Output("container"), "figures": Output(KIND)},
    version=1,
    modules=lambda parameters: [module_of(parameters.method)],
)
def recover(context: Context, parameters: RecoverParameters) -> None:
    """Register the found container with the published one, and undo what was done to all of it alike.

    The result has the published networks, and the secret of the published container reads it. Raises `UserError` if
    nothing published is recognised in the found container.

    One row of `figures` is the verdict. `is_yours`: of the found or the published Gaussians, whichever are fewer, at
    least a quarter are paired by exact shape, or by position with a tenth of the pairs of exactly the same shape, or
    four fifths by position alone. This includes fragments, and containers with any additions. `may_be_yours`: less than
    that agrees. Either each Gaussian was shifted or changed, or much was left out and more was added, or it is another
    training from the same photos, or a part of one. Such trainings had a `matched` of up to 22 % after 3,000
    iterations, of 23 % for the fox after 300, of 72 % after 40, which hardly move the initial points, and parts of them
    up to 65 %; none of it by shape.

    The other rows: whether the scene was mirrored, and how far it was then rotated, moved and scaled; the share of the
    found Gaussians that are published ones (`matched`), and of the published ones that were found (`found_again`); how
    much features were changed back; and the numbers of Gaussians found and published.
    """
    torch.set_num_threads(parameters.threads)
    found, published = context.input("found"), context.input("published")
    for container in (found, published):
        check_method(container, parameters.method)
    gaussians, originals = read_gaussians(found), read_gaussians(published)
    _check_alike(found, gaussians, originals)
    try:
        recovery = recovered(gaussians, originals, parameters.seed)
    except TooFewPairs as few:
        raise _unmapped(found, few) from few
    if recovery is None:
        raise _not_known(gaussians, originals)
    _refuse_infinite("what was moved back has values that are not numbers", found, recovery.gaussians)
    context.log(_said(recovery))
    write_container(context.output("container"), recovery.gaussians, read_method(published))
    facts = _facts(recovery)
    verdict = IS_YOURS if recovery.is_certain else MAY_BE_YOURS
    figures = {verdict: 1, **facts, "gaussians_found": len(gaussians), "gaussians_published": len(originals)}
    rows = [Measurement(name, float(value), AS_FOUND, method=parameters.method) for name, value in figures.items()]
    write_measurements(context.output("figures"), rows)
    context.record(**facts)


def _not_known(gaussians: Gaussians, originals: Gaussians) -> UserError:
    return UserError(
        "not recognised as yours: the found container matches nothing that was published",
        found=f"{len(gaussians)} Gaussians, of which too few are among the {len(originals)} published",
        expected="the published container, possibly moved, pruned or with other features, with at least ten of its "
        "Gaussians left",
        remedy="give the container that the found one was made from, as `published` (for "
        "workflows/recover_container.yaml in `hidden`); a container that was retrained, or whose positions, "
        "sizes and opacities all changed, cannot be registered",
    )


def _unmapped(found: Artifact, few: TooFewPairs) -> UserError:
    whose = "This is your container" if few.is_certain else "This may be your container"
    return UserError(
        f"{whose}, but too little of it is left to read the message",
        where=str(found.path),
        found=f"{few.channels} feature channels instead of {few.published}, and {few.pairs} of the published Gaussians",
        expected=f"at least {few.needed} of them, to tell how {few.channels} channels became {few.published}",
        remedy="remove feature columns that were added, or find more of it",
    )


def _facts(recovery: Recovery) -> dict[str, float]:
    return {
        "mirrored": float(recovery.mirrored),
        "degrees": recovery.degrees,
        "shift": recovery.shift,
        "scale": recovery.motion.scale,
        "matched": recovery.matched,
        "found_again": recovery.found_again,
        "feature_change": recovery.feature_change,
    }


def _check_alike(found: Artifact, gaussians: Gaussians, originals: Gaussians) -> None:
    others = unlike(gaussians.parameters, originals.parameters)
    if others:
        raise UserError(
            "the containers do not have the same attributes",
            where=str(found.path),
            found=f"different {', '.join(others)}",
            expected="the attributes and shapes of the published container",
            remedy="give as `published` the container that the found one was made from",
        )
    _refuse_infinite("the found container has values that are not numbers", found, gaussians)


def _refuse_infinite(what: str, found: Artifact, gaussians: Gaussians) -> None:
    finite = {
        name: values.isfinite().flatten(1).all(dim=1) if values.ndim > 1 else values.isfinite()
        for name, values in gaussians.parameters.items()
    }
    broken = [name for name, rows in finite.items() if not rows.all()]
    if broken:
        wrong = (~torch.stack(list(finite.values())).all(dim=0)).nonzero().flatten().tolist()
        rows = ", ".join(map(str, wrong[:LISTED])) + (", …" if len(wrong) > LISTED else "")
        raise UserError(
            what,
            where=str(found.path),
            found=f"NaN or infinity in {', '.join(broken)} of {len(wrong)} of {len(gaussians)} Gaussians, rows {rows}",
            expected="finite values",
            remedy="remove these Gaussians",
        )


def _said(recovery: Recovery) -> str:
    made = "made from" if recovery.is_certain else "perhaps made from"
    features = f"changed back by {recovery.feature_change:.4f}" if recovery.feature_change else "left as they are"
    turned = f"{'mirrored, ' if recovery.mirrored else ''}turned"
    return (
        f"{made} what was published: {turned} by {recovery.degrees:.3f} degrees, moved by {recovery.shift:.4g}, "
        f"scaled by {recovery.motion.scale:.6g}; {recovery.matched:.1%} of the Gaussians are published ones, "
        f"{recovery.found_again:.1%} of the published ones are there; features {features}"
    )
