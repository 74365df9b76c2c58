"""`quadwalk tune`: search the settings of a task that make its policy best."""
