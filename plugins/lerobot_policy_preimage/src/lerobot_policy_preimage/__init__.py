"""preimage as a policy of LeRobot, which finds this package by its name."""

from lerobot_policy_preimage.configuration_preimage import PreimageConfig
from lerobot_policy_preimage.modeling_preimage import PreimagePolicy
from lerobot_policy_preimage.processor_preimage import make_preimage_pre_post_processors

__all__ = ["PreimageConfig", "PreimagePolicy", "make_preimage_pre_post_processors"]
