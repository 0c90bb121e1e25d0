"""The folder of a campaign. In: rows as they finish. Out: one table, whole at any moment, of this campaign and no other."""
