"""Who may publish what: certificates, names and the access rules made from the topics table."""
