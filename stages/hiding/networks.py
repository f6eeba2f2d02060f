"""Which networks of a method are published, and which remain secret."""

PUBLIC_NETWORKS = ("scene_decoder",)
SECRET_NETWORKS = ("message_decoder",)
