"""Which networks of a method are published, and which remain secret."""

SCENE_DECODER, MESSAGE_DECODER = "scene_decoder", "message_decoder"

PUBLIC_NETWORKS = (SCENE_DECODER,)
SECRET_NETWORKS = (MESSAGE_DECODER,)
