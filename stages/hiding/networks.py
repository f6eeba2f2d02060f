"""Which networks of a method are published, and which only the owner keeps."""

PUBLIC_NETWORKS = ("scene_decoder",)
SECRET_NETWORKS = ("message_decoder",)
