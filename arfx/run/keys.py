"""Digests of all that a job's facts, and its pixels, depend on: what an earlier run left
counts where they are the same.
"""

from dataclasses import replace

from arfx.config.sections import frozen
from arfx.run.folder import code_digest, digest, file_digest
from arfx.run.inputs import Inputs
from arfx.run.parameters import pipeline, required_facts
from arfx.stages import STAGES


def job_keys(inputs: Inputs) -> tuple[str, str]:
    """(of the analysis, of the whole job). Reads every input file."""
    config = inputs.config
    assert config.input.clip is not None
    tree = frozen(config)
    del tree["output"]
    output = replace(inputs.output, path=inputs.output.path.absolute())
    model = sorted(
        (str(path), file_digest(path)) for path in inputs.model.files
    )  # textures and buffers too
    more = (
        config.input.marker_map,
        config.input.poses,
        config.params["light"].environment,
        *(p.image for p in config.patterns),
    )
    base = [
        code_digest(),
        file_digest(config.input.clip),
        inputs.camera.to_json(),
        *(
            tree[section]
            for section in ("input", "marker", "pattern", "analyse", "light")
        ),
        config.model.anchor,
        sorted(required_facts(config)),
        *(file_digest(path) for path in more if path),
    ]
    maps = (
        []
        if inputs.depth is None
        else [(p.name, file_digest(p)) for p in inputs.depth.files]
    )
    plugins = [
        code_digest(*STAGES.source(name))
        for name in pipeline(config)
        if name in STAGES.plugins
    ]
    return digest(*base), digest(*base, tree, model, output.to_json(), maps, plugins)
