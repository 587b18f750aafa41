"""A bare body and an outfit in; garments, hair, shoes and headgear as meshes out.

A new garment is one cut in `garments` and one name in `outfit`.
"""
