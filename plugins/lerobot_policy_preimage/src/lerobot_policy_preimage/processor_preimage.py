"""Nothing is normalised: the run knows the range of its joints and pixels. Observations get a batch dimension and their device."""

from typing import Any

from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    DeviceProcessorStep,
    PolicyAction,
    PolicyProcessorPipeline,
    RenameObservationsProcessorStep,
)
from lerobot.processor.converters import policy_action_to_transition, transition_to_policy_action

from lerobot_policy_preimage.configuration_preimage import PreimageConfig


def make_preimage_pre_post_processors(
    config: PreimageConfig, dataset_stats: dict[str, Any] | None = None
) -> tuple[PolicyProcessorPipeline[dict[str, Any], dict[str, Any]], PolicyProcessorPipeline[PolicyAction, PolicyAction]]:
    """What LeRobot runs before and after the policy; the name is the one it looks for."""
    device = DeviceProcessorStep(device=config.device or "cpu")
    before = PolicyProcessorPipeline(
        steps=[RenameObservationsProcessorStep(rename_map={}), AddBatchDimensionProcessorStep(), device], name="policy_preprocessor"
    )
    after = PolicyProcessorPipeline(
        steps=[DeviceProcessorStep(device="cpu")],
        name="policy_postprocessor",
        to_transition=policy_action_to_transition,
        to_output=transition_to_policy_action,
    )
    return before, after
