"""The service: the record of jobs and campaigns, its queue and files, keys, settings.

HTTP is in `scene_attack_api`, and what runs jobs in `scene_attack_worker`.
"""
